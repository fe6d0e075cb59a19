//! `glisson serve`.

use super::held::DeviceArgs;
use super::resuming::open_recorded;
use anyhow::bail;
use glisson_net::link::Role;
use glisson_net::options::NetArgs;
use glisson_runtime::haptic_loop::{HapticSettings, HeldTool, ToolLink};
use glisson_runtime::published::Lateness;
use glisson_runtime::realtime::{CoreKept, OwnCore};
use glisson_runtime::remote_figures::RemoteFigures;
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::patient::{self, PatientPage};
use glisson_view::server::access::Access;
use glisson_view::server::{self, Compare, Served, Service, Show, stop_signal};
use std::net::TcpListener;
use std::path::PathBuf;

/// Serve the viewer and simulate a scene in real time.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson serve out/demo/scene.toml\n  \
    glisson serve scene.toml --port 0 --record session.jsonl\n  \
    glisson serve scene.toml --record session.jsonl --resume session.jsonl.partial    after a crash\n  \
    glisson serve scene.toml --device haply --device simulated@1\n  \
    glisson serve scene.toml --device viewer         the page's mouse, keyboard and gamepad as a device\n  \
    glisson serve scene.toml --device trocar:10.0.0.7:4000,mapping=virtual-work --force-estimate hold\n  \
    glisson serve scene.toml --host 0.0.0.0      for other machines, with a token that is printed\n\nStop with Ctrl-C; a recording is then completed.")]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    #[command(flatten)]
    address: Address,
    /// Record the session to this file
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Go on with this session of the scene that was cut off (FILE.partial, or what it is called now): it is replayed to its last moment,
    /// where it stands still at first, and recorded anew with all that comes
    #[arg(long, value_name = "FILE", requires = "record")]
    resume: Option<PathBuf>,
    #[command(flatten)]
    devices: DeviceArgs,
    /// Threads of the explicit model; the results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    threads: u8,
    #[command(flatten)]
    network: NetArgs,
}

/// What is on the network beside the viewer.
#[derive(Default)]
struct Network {
    remote: Vec<ToolLink>,
    /// Of the haptic loop on the other machine.
    remote_figures: Option<RemoteFigures>,
    shows: Vec<Show>,
}

/// Whether a browser is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Opening {
    No,
    /// The address has the token in it, and a browser's arguments stand in the list of processes.
    NotWithToken,
    Yes,
}

/// Where the viewer is served.
#[derive(Debug, clap::Args)]
pub(crate) struct Address {
    /// Address to listen on; anything but this machine's own lets those who know the token steer the simulation
    #[arg(long, default_value = "127.0.0.1")]
    host: String,
    /// Port to listen on; 0 takes any free one
    #[arg(long, default_value_t = 8077)]
    port: u16,
    /// What others have to know to connect, at least 16 letters and digits; also read from the variable GLISSON_TOKEN,
    /// which other users of the machine do not see. An address that is not this machine's own gets a random one
    #[arg(long, value_name = "TEXT")]
    token: Option<String>,
    /// Do not open a browser; with a token none is opened
    #[arg(long)]
    no_open: bool,
}

impl Address {
    /// Takes the port now.
    pub(crate) fn bind(&self) -> anyhow::Result<TcpListener> {
        server::bind(&self.host, self.port)
    }

    /// Tells the address, opens a browser where there is a display, and serves until Ctrl-C.
    pub(crate) fn serve(&self, simulation: Simulation, listener: TcpListener) -> anyhow::Result<()> {
        self.serve_with(simulation, listener, Vec::new(), HapticSettings::default(), Network::default())
    }

    /// The same with a task whose results are stored: `show` sees what is published, reports compare by `compare`.
    pub(crate) fn serve_task(
        &self,
        simulation: Simulation,
        listener: TcpListener,
        (show, compare): (Show, Compare),
    ) -> anyhow::Result<()> {
        let access = self.tell(&listener)?;
        let service = Service { shows: vec![show], compare: Some(compare), ..Service::to(access) };
        serve_until_stopped(simulation, listener, service)
    }

    /// The same with instruments that devices hold.
    fn serve_with(
        &self,
        simulation: Simulation,
        listener: TcpListener,
        held: Vec<(HeldTool, ToolLink)>,
        haptics: HapticSettings,
        network: Network,
    ) -> anyhow::Result<()> {
        let Network { remote, remote_figures, shows } = network;
        let access = self.tell(&listener)?;
        let service = Service { held, haptics, remote, remote_figures, shows, ..Service::to(access) };
        serve_until_stopped(simulation, listener, service)
    }

    /// Serves the page for a new patient, and its simulation at the same address once that is ready.
    pub(crate) fn serve_patient(&self, page: PatientPage, listener: TcpListener) -> anyhow::Result<()> {
        let access = self.tell(&listener)?;
        match patient::serve(listener.try_clone()?, access.clone(), page, stop_signal())? {
            Some(simulation) => serve_until_stopped(simulation, listener, Service::to(access)),
            None => Ok(()),
        }
    }

    /// Says where the page is and opens a browser where there is a display; answers who may connect.
    pub(crate) fn tell(&self, listener: &TcpListener) -> anyhow::Result<Access> {
        let address = listener.local_addr()?;
        let access = Access::for_address(address.ip(), self.given_token())?;
        let page = server::page_address(address) + &access.address_suffix();
        println!("Glisson is at {page}  (Ctrl-C stops it)");
        println!("who teaches goes to {}", server::page_address(address) + &access.teacher_suffix());
        match self.opens_browser(access.needs_token(), std::env::var_os("DISPLAY").is_some()) {
            Opening::No => {}
            Opening::NotWithToken => println!(
                "open it in a browser; it is not done here, where all users see a program's arguments"
            ),
            // Without a browser to open, the printed address is enough.
            Opening::Yes => drop(
                std::process::Command::new("xdg-open")
                    .arg(&page)
                    .stdout(std::process::Stdio::null())
                    .stderr(std::process::Stdio::null())
                    .spawn(),
            ),
        }
        Ok(access)
    }

    fn opens_browser(&self, needs_token: bool, has_display: bool) -> Opening {
        match (self.no_open || !has_display, needs_token) {
            (true, _) => Opening::No,
            (false, true) => Opening::NotWithToken,
            (false, false) => Opening::Yes,
        }
    }

    fn given_token(&self) -> Option<String> {
        self.token.clone().or_else(|| std::env::var("GLISSON_TOKEN").ok())
    }
}

/// Serves until Ctrl-C, and says how it went.
fn serve_until_stopped(
    simulation: Simulation,
    listener: TcpListener,
    service: Service,
) -> anyhow::Result<()> {
    serve_until(simulation, listener, service, stop_signal())
}

/// Serves until `stop` comes or a page leaves, and says how it went.
pub(super) fn serve_until(
    simulation: Simulation,
    listener: TcpListener,
    service: Service,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let Served { ended, haptics, was_left } = server::serve(simulation, listener, service, stop)?;
    if let Some(haptics) = haptics {
        println!("{}", haptics.to_text());
    }
    println!("{}", ended.times.to_text());
    if ended.lateness.n_given_up > 0 {
        let Lateness { n_given_up, left_out_s } = ended.lateness;
        println!("the simulation fell behind {n_given_up} times and left out {left_out_s:.1} s");
    }
    let how = if was_left { "left" } else { "stopped" };
    println!("{how}; state hash {}", ended.state_hash);
    Ok(())
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    // Before anything else is started. Without devices nobody needs a core.
    let kept = args.devices.keep_core();
    let core = kept.as_ref().map_or(OwnCore::Last, CoreKept::core);
    let haptics = args.devices.settings(core)?;
    let link = args.network.link()?;
    if let Some(link) = link.as_ref().filter(|link| link.role == Role::Haptics) {
        if args.record.is_some() || args.network.has_shows() {
            bail!("--record, --igtl and --ros2 belong to the machine with --role simulation");
        }
        if args.devices.devices.iter().any(|device| device.name.is("viewer")) {
            bail!("--device viewer with --role haptics: the page is at the machine with --role simulation");
        }
        let source = OpenScene::read(&args.scene)?;
        let held = args.devices.held(&source.scene.world.tools, core)?;
        return link.run_haptics(&source, held, haptics, stop_signal());
    }
    if link.is_some() && !args.devices.devices.is_empty() {
        bail!("--device with --role simulation: the devices are at the machine with --role haptics");
    }
    let listener = args.address.bind()?;
    let source =
        OpenScene { n_threads: args.devices.n_threads(args.threads, core), ..OpenScene::read(&args.scene)? };
    let scene_text = source.scene.text.clone();
    let simulation = match (&args.record, &args.resume) {
        (Some(record), resume) => open_recorded(source, record, resume.as_deref())?,
        (None, _) => Simulation::open(source, None)?,
    };
    let held = args.devices.held(simulation.world().tools(), core)?;
    let in_hands: Vec<usize> = held.iter().map(|(_, link)| link.tool).collect();
    let mut network = Network { shows: args.network.shows(&simulation, &in_hands)?, ..Network::default() };
    let mut conversation = None;
    if let Some(link) = &link {
        let figures = RemoteFigures::default();
        let (started, remote) = link.start_simulation(&simulation, &scene_text, figures.clone())?;
        conversation = Some(started);
        (network.remote, network.remote_figures) = (remote, Some(figures));
    }
    args.address.serve_with(simulation, listener, held, haptics, network)?;
    if let Some(conversation) = conversation {
        println!("{}", conversation.report().to_text());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_stands_in_no_browsers_arguments() {
        let address = |no_open| Address { host: "127.0.0.1".into(), port: 0, token: None, no_open };
        for (no_open, needs_token, has_display, expected) in [
            (false, false, true, Opening::Yes),
            (false, true, true, Opening::NotWithToken),
            (false, false, false, Opening::No),
            (false, true, false, Opening::No),
            (true, true, true, Opening::No),
            (true, false, true, Opening::No),
        ] {
            assert_eq!(address(no_open).opens_browser(needs_token, has_display), expected);
        }
    }
}
