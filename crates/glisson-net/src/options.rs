//! What `glisson serve` is told about the network.

use super::bridge::{DeviceNews, HapticsScene, HapticsSide, start_haptics, start_simulation};
use super::conversation::{Conversation, Identity, LinkReport};
use super::igtl;
use super::link::{Role, ZenohAddress};
use super::link_address::LinkAddress;
use super::messages::SceneHash;
use super::player::Player;
use super::seal::Seal;
#[cfg(feature = "net")]
use super::zenoh_link::{SharedSession, open_session};
use anyhow::{Context, bail};
use glisson::scene::{mesh_hash, read_organ, read_tools};
use glisson::tool::{Tool, ToolInput};
use glisson::world::detection::SurfaceList;
use glisson_runtime::haptic_loop::{DeviceStatus, HapticLoop, HapticSettings, HeldTool, ToolLink};
use glisson_runtime::remote_figures::RemoteFigures;
use glisson_runtime::steering::Show;
use glisson_runtime::{OpenScene, Simulation};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The network.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Network")]
pub struct NetArgs {
    /// Share the session with another machine
    #[arg(long, value_enum, requires = "link")]
    role: Option<Role>,
    /// How to reach the other machine: udp://HOST:PORT, where the simulation listens; or with the feature `net` zenoh:
    /// (by multicast), zenoh:tcp/HOST:PORT or zenoh:FILE.json5 (its own configuration, with TLS)
    #[arg(long, value_name = "ADDRESS", requires = "role")]
    link: Option<LinkAddress>,
    /// File with a secret, at least 16 random bytes, the same on both machines: only who has it can steer
    #[arg(long, value_name = "FILE", requires = "link")]
    link_key: Option<PathBuf>,
    /// Show tools and organ to OpenIGTLink clients (3D Slicer) that connect to this address
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:18944")]
    igtl: Option<SocketAddr>,
    /// Let OpenIGTLink clients of other machines connect: the protocol knows no password, so whoever reaches the address sees
    /// organ and instruments (nobody can steer there)
    #[arg(long, requires = "igtl")]
    igtl_open: bool,
    /// Axes of what OpenIGTLink clients get
    #[arg(long, value_enum, default_value_t, requires = "igtl")]
    igtl_axes: igtl::Axes,
    /// Publish ROS 2 topics in this domain, as a node of rmw_zenoh; needs the feature `net`
    #[arg(long, value_name = "DOMAIN", num_args = 0..=1, default_missing_value = "0")]
    ros2: Option<u32>,
    /// Let CRTK clients move the instruments that no device holds (state_command, servo_cp, move_cp, jaw/servo_jp): whoever
    /// reaches the router of ROS 2 can
    #[arg(long, requires = "ros2")]
    ros2_control: bool,
    /// How to reach the router of ROS 2 where no zenoh link is there, whose session is otherwise used
    /// [default: zenoh:tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ADDRESS", requires = "ros2")]
    ros2_link: Option<LinkAddress>,
    /// Let whoever reaches the topics of ROS 2 from other machines see organ and instruments, and with --ros2-control move
    /// them: topics know no password, and no --link-key seals them
    #[arg(long, requires = "ros2")]
    ros2_open: bool,
    /// Of the link, which ROS 2's topics share.
    #[cfg(feature = "net")]
    #[arg(skip)]
    session: SharedSession,
}

/// Where the router of ROS 2 is unless told otherwise: `rmw_zenohd` listens there.
const ROS2_ROUTER: &str = "tcp/127.0.0.1:7447";

/// What carries ROS 2's topics.
#[cfg_attr(not(feature = "net"), allow(dead_code, reason = "without zenoh only the tests ask"))]
#[derive(Clone, Debug, PartialEq, Eq)]
enum Ros2Over {
    /// The link's session.
    Link(ZenohAddress),
    /// A session of its own.
    Own(ZenohAddress),
}

/// A link as asked for on the command line.
pub struct LinkOptions {
    /// Which of the two machines this one is.
    pub role: Role,
    address: LinkAddress,
    seal: Seal,
    #[cfg(feature = "net")]
    session: SharedSession,
}

impl NetArgs {
    /// The role that was asked for, with its link.
    ///
    /// # Errors
    /// When the key cannot be used.
    pub fn link(&self) -> anyhow::Result<Option<LinkOptions>> {
        let (Some(role), Some(address)) = (self.role, &self.link) else { return Ok(None) };
        let seal = self.link_key.as_deref().map_or(Ok(Seal::Check), Seal::from_file)?;
        Ok(Some(LinkOptions {
            role,
            address: address.clone(),
            seal,
            #[cfg(feature = "net")]
            session: self.session.clone(),
        }))
    }

    /// Whether anything shows the simulation beside the viewer.
    pub fn has_shows(&self) -> bool {
        self.igtl.is_some() || self.ros2.is_some()
    }

    /// What shows `simulation` beside the viewer; tells where. `held`: numbers of the instruments that devices hold.
    ///
    /// # Errors
    /// When an address cannot be used, or there is no instrument for CRTK's clients to move.
    pub fn shows(&self, simulation: &Simulation, held: &[usize]) -> anyhow::Result<Vec<Show>> {
        let mut shows: Vec<Show> = Vec::new();
        if let Some(address) = self.igtl {
            if !address.ip().is_loopback() && !self.igtl_open {
                bail!(
                    "--igtl {address} can be reached from other machines, and OpenIGTLink knows no password: whoever reaches it \
                     sees organ and instruments; give --igtl-open if that is meant, or an address of this machine only \
                     (127.0.0.1:{}) and a tunnel",
                    address.port()
                );
            }
            let listener = igtl::bind(address)?;
            let (address, axes) = (listener.local_addr()?, self.igtl_axes);
            println!("OpenIGTLink is at {address} (mm, {})", axes.name());
            let spec = simulation.world().spec();
            let tool_names = spec.tools.iter().map(|tool| tool.name.clone()).collect();
            let organ_name = if spec.name.is_empty() { "organ".to_owned() } else { spec.name.clone() };
            let described = igtl::Described { axes, tool_names, organ_name };
            shows.push(Box::new(move |published, _| igtl::spawn(listener, described, published)));
        }
        if let Some(domain) = self.ros2 {
            shows.push(self.ros2_topics(domain, simulation, held)?);
        }
        Ok(shows)
    }

    #[cfg(feature = "net")]
    fn ros2_topics(&self, domain: u32, simulation: &Simulation, held: &[usize]) -> anyhow::Result<Show> {
        let over = self.ros2_over()?;
        if self.ros2_control && self.role.is_some() {
            bail!(
                "--ros2-control with --role simulation: the instruments are in the hands of the other machine"
            );
        }
        let is_ordered = |tool| self.ros2_control && !held.contains(&tool);
        let described = super::ros2::Described::of(simulation.world().tools(), is_ordered);
        if self.ros2_control && !described.takes_orders() {
            bail!("--ros2-control: devices hold all instruments; leave out one --device, or --ros2-control");
        }
        let session = self.ros2_session(&over)?;
        let (address, with_link) = match &over {
            Ros2Over::Link(address) => (address, ", with the link over one session"),
            Ros2Over::Own(address) => (address, ""),
        };
        let address = LinkAddress::Zenoh(address.clone());
        println!("ROS 2 topics of domain {domain} go to {address}{with_link}");
        if self.ros2_control {
            println!("whoever reaches {address} can move the instruments that no device holds");
        }
        Ok(Box::new(move |published, steering| {
            super::ros2::spawn(session, domain, described, published, steering)
        }))
    }

    /// The session that carries ROS 2's topics; opened if nobody has done so.
    ///
    /// # Errors
    /// When strangers could get there and nobody said that they may.
    #[cfg(feature = "net")]
    fn ros2_session(&self, over: &Ros2Over) -> anyhow::Result<super::ros2::Over> {
        Ok(match over {
            Ros2Over::Link(address) => {
                let link = self.link()?.context("a link is there to be shared")?;
                link.check()?;
                self.check_ros2(address)?;
                super::ros2::Over { session: link.zenoh_session()?, is_own: false }
            }
            // It connects to the router, as the haptics machine does to the simulation.
            Ros2Over::Own(address) => {
                self.check_ros2(address)?;
                super::ros2::Over { session: open_session(address, Role::Haptics)?, is_own: true }
            }
        })
    }

    #[cfg(feature = "net")]
    fn check_ros2(&self, address: &ZenohAddress) -> anyhow::Result<()> {
        match address.open_door()? {
            Some(door) if !self.ros2_open => bail!(
                "--ros2: {} can be reached from other machines ({door}), and ROS 2's topics know no password: whoever reaches \
                 them {}; give --ros2-open if that is meant, or a configuration file whose endpoints are tls/ or quic/ with \
                 enable_mtls, and without multicast (docs/network.md)",
                LinkAddress::Zenoh(address.clone()),
                if self.ros2_control { "moves the instruments" } else { "sees organ and instruments" }
            ),
            _ => Ok(()),
        }
    }

    #[cfg(not(feature = "net"))]
    fn ros2_topics(&self, domain: u32, _: &Simulation, _: &[usize]) -> anyhow::Result<Show> {
        self.ros2_over()?;
        bail!("--ros2 {domain}: this program was built without zenoh; build it with --features net")
    }

    /// What carries ROS 2's topics: the link's session if that is zenoh's.
    ///
    /// # Errors
    /// For an address that is not zenoh's or that is not the link's.
    fn ros2_over(&self) -> anyhow::Result<Ros2Over> {
        let asked = match &self.ros2_link {
            Some(LinkAddress::Zenoh(asked)) => Some(asked),
            Some(other) => bail!("--ros2-link {other}: ROS 2 is reached over zenoh: only"),
            None => None,
        };
        match (&self.link, asked) {
            (Some(link @ LinkAddress::Zenoh(linked)), Some(asked)) if linked != asked => bail!(
                "--ros2-link {} contradicts --link {link}: link and topics share one zenoh session; leave --ros2-link out, \
                 and name the router in the link's configuration (zenoh:FILE.json5, docs/network.md)",
                LinkAddress::Zenoh(asked.clone())
            ),
            (Some(LinkAddress::Zenoh(linked)), _) => Ok(Ros2Over::Link(linked.clone())),
            (_, Some(asked)) => Ok(Ros2Over::Own(asked.clone())),
            (_, None) => Ok(Ros2Over::Own(ZenohAddress::Locator(ROS2_ROUTER.to_owned()))),
        }
    }
}

fn scene_hash(scene_text: &str, mesh_hash: &str) -> SceneHash {
    let mut hasher = blake3::Hasher::new();
    // The length keeps text and hash apart.
    hasher.update(&(scene_text.len() as u64).to_le_bytes());
    hasher.update(scene_text.as_bytes()).update(mesh_hash.as_bytes());
    SceneHash(*hasher.finalize().as_bytes())
}

/// How stiff an elastic half-space is under a flat round punch [N/m]: 2 E a / (1 - nu^2) (Sneddon 1965,
/// doi:10.1016/0020-7225(65)90019-4).
fn flat_punch_n_per_m(young_modulus_pa: f64, poisson_ratio: f64, radius_m: f64) -> f64 {
    2.0 * young_modulus_pa * radius_m / (1.0 - poisson_ratio * poisson_ratio)
}

impl LinkOptions {
    #[cfg(feature = "net")]
    fn check(&self) -> anyhow::Result<()> {
        self.address.check(self.seal.has_key())
    }

    /// The link's session; opened if nobody has done so.
    #[cfg(feature = "net")]
    fn zenoh_session(&self) -> anyhow::Result<zenoh::Session> {
        self.check()?;
        match &self.address {
            LinkAddress::Zenoh(address) => self.session.get(address, self.role),
            other => bail!("{other} is no link over zenoh"),
        }
    }

    fn open(&self, scene: SceneHash, n_tools: usize) -> anyhow::Result<(super::link::Link, Identity)> {
        let has_key = self.seal.has_key();
        #[cfg(feature = "net")]
        if let LinkAddress::Zenoh(_) = &self.address {
            let link = super::zenoh_link::link_over(self.zenoh_session()?, self.role)?;
            return Ok((link, Identity { role: self.role, scene, n_tools, seal: self.seal.clone() }));
        }
        let link = self.address.open(self.role, has_key)?;
        Ok((link, Identity { role: self.role, scene, n_tools, seal: self.seal.clone() }))
    }

    /// Starts the simulating machine's end: the instruments are held elsewhere. `scene_text` is what `simulation` was
    /// opened from.
    ///
    /// # Errors
    /// When the link cannot be opened.
    pub fn start_simulation(
        &self,
        simulation: &Simulation,
        scene_text: &str,
        figures: RemoteFigures,
    ) -> anyhow::Result<(Conversation, Vec<ToolLink>)> {
        let homes: Vec<ToolInput> = simulation.world().tools().iter().map(|tool| tool.home).collect();
        let scene = scene_hash(scene_text, &simulation.mesh_hash());
        let (link, identity) = self.open(scene, homes.len())?;
        Ok(start_simulation(link, identity, &homes, figures)?)
    }

    /// The whole haptics machine: `held` by devices, or by the scene's own paths when there are none; until `stop` comes.
    ///
    /// # Errors
    /// When the scene cannot be read or the link cannot be opened.
    pub fn run_haptics(
        &self,
        source: &OpenScene,
        held: Vec<(HeldTool, ToolLink)>,
        haptics: HapticSettings,
        stop: impl Future<Output = ()>,
    ) -> anyhow::Result<()> {
        let body = read_organ(&source.scene, &source.folder).with_context(|| source.origin.clone())?;
        let tools = read_tools(&source.scene, &source.folder).with_context(|| source.origin.clone())?;
        let surface = SurfaceList::of_mesh(&body.mesh).with_context(|| source.origin.clone())?;
        let scene = scene_hash(&source.scene.text, &mesh_hash(&body));
        let (link, identity) = self.open(scene, tools.len())?;
        let n_triangles = surface.triangles.len();
        let (young_pa, poisson) = (body.material.young_modulus_pa(), body.material.poisson_ratio());
        let stiffness = |tool: &Tool| flat_punch_n_per_m(young_pa, poisson, tool.tip_radius_m);
        let stiffness_n_per_m = tools.iter().map(stiffness).collect();
        let (player, haptic_loop, links) = if held.is_empty() {
            println!("no device: the scene's paths move the instruments");
            let (player, links) = Player::start(&source.scene)?;
            (Some(player), None, links)
        } else {
            let (held, links): (Vec<_>, Vec<_>) = held.into_iter().unzip();
            (None, Some(HapticLoop::start(held, haptics, Arc::default())?), links)
        };
        let meters = haptic_loop.as_ref().map(|haptic_loop| Arc::clone(haptic_loop.meters()));
        let held = HapticsScene { tools, surface: Some(surface), stiffness_n_per_m, meters };
        let HapticsSide { conversation, detection, news } = start_haptics(link, identity, held, links)?;
        println!("touches are looked for here, on {n_triangles} triangles");
        println!("haptics run (Ctrl-C stops them)");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        runtime.block_on(async {
            tokio::select! {
                () = stop => {}
                () = tell_changes(&conversation, news, &self.address) => {}
            }
        });
        if let Some(haptic_loop) = haptic_loop {
            println!("{}", haptic_loop.meters().report().to_text());
            println!("felt: {}", haptic_loop.meters().felt().to_json());
        }
        if let Some(player) = player {
            println!("played: {}", serde_json::to_string(&player.finish())?);
        }
        println!("detection: {}", serde_json::to_string(&detection.report())?);
        println!("{}", conversation.report().to_text());
        Ok(())
    }
}

/// How often what changed is told.
const TELL_EVERY: Duration = Duration::from_millis(50);
/// How long a simulation may take to be found before that is told.
const PATIENCE: Duration = Duration::from_secs(10);

/// Says what changes at the link and at the devices; never ends.
async fn tell_changes(conversation: &Conversation, mut news: Vec<DeviceNews>, address: &LinkAddress) {
    let mut tick = tokio::time::interval(TELL_EVERY);
    let mut waited = Some(Duration::ZERO);
    let mut was_up = false;
    loop {
        tick.tick().await;
        let is_up = conversation.report().is_up;
        waited = waited.filter(|_| !is_up).map(|so_far| so_far + TELL_EVERY);
        if waited.is_some_and(|so_far| so_far >= PATIENCE) {
            println!("no simulation is found over {address}: {}; it is waited for", address.advice());
            waited = None;
        }
        if is_up != std::mem::replace(&mut was_up, is_up) {
            println!(
                "{}",
                if is_up { "the simulation is there" } else { "nothing comes from the simulation" }
            );
        }
        for DeviceNews { device_name, statuses } in &mut news {
            match statuses.get_new() {
                Some(DeviceStatus::Lost(why)) => println!("the device {device_name} was lost: {why}"),
                Some(DeviceStatus::Failed(why)) => println!("the device {device_name} failed: {why}"),
                Some(DeviceStatus::WorksWith(i)) => {
                    println!("the device {device_name} works; in it: {}, number {}", i.name, i.serial);
                }
                Some(DeviceStatus::Works) => println!("the device {device_name} works"),
                Some(DeviceStatus::Waiting) | None => {}
            }
        }
    }
}

impl LinkReport {
    /// For people.
    pub fn to_text(&self) -> String {
        let counts = self.counts;
        let us = |ns: u64| ns as f64 * 1e-3;
        format!(
            "link: {} messages sent, {} taken, {} lost, {} late, {} refused, {} cuts; round trip p50 {:.0} us, p99 {:.0} us",
            self.n_sent,
            counts.n_taken,
            counts.n_lost,
            counts.n_late,
            self.n_refused,
            self.n_cuts,
            us(self.round_trip.p50_ns),
            us(self.round_trip.p99_ns),
        )
    }
}

#[cfg(test)]
#[path = "options_tests.rs"]
mod tests;
