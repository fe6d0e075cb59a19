//! `glisson devices`.

use super::device_page::DevicePage;
use anyhow::ensure;
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, InsertedInstrument};
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson_runtime::devices::lead::{self, LeadRequest};
use glisson_runtime::devices::trocar_choice::OPTIONS;
use glisson_runtime::devices::{self, DeviceName, HAPLY_ADDRESS, KINDS, host_and_port};
use glisson_runtime::histogram::Histogram;
use glisson_runtime::open_device::OpenDevice;
use glisson_runtime::realtime::{OwnCore, make_punctual, now_ns, wait_until};
use glisson_view::server::{has_page, stop_signal};
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Force-feedback devices: which there are, whether one works, what is missing.
#[derive(Debug, clap::Args)]
#[command(
    arg_required_else_help = true,
    after_help = "Examples:\n  glisson devices list\n  glisson devices doctor\n  \
                  glisson devices test haply --seconds 5\n  glisson devices test force-dimension --json\n  \
                  glisson devices test viewer\n  \
                  glisson devices lead trocar trocar --seconds 5\n\n\
                  A device is used with: glisson serve scene.toml --device NAME"
)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// The kinds of devices and how they are named
    #[command(after_help = "Example:\n  glisson devices list")]
    List,
    /// Open a device, read it for a while without any force, and tell how it does
    #[command(
        after_help = "Examples:\n  glisson devices test simulated\n  glisson devices test haply --seconds 10 --json"
    )]
    Test {
        /// Its name, as `glisson devices list` shows
        name: DeviceName,
        /// How long [s]
        #[arg(long, value_name = "S", default_value_t = 3.0)]
        seconds: f64,
        /// Ticks a second [Hz]
        #[arg(long, value_name = "HZ", default_value_t = 1000.0)]
        rate: f64,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Let a device drive an active trocar, whose forces come back: force-feedback teleoperation
    #[command(
        after_help = "Examples:\n  glisson devices lead trocar trocar --seconds 5        without hardware\n  \
                      glisson devices lead trocar:10.0.0.7:4000 trocar:10.0.0.8:4000,profile=specified\n  \
                      glisson devices lead haply trocar:10.0.0.8:4000 --scale 0.5\n\n\
                      Both are coupled where they are when they answer. Ctrl-C ends it: forces go to zero slowly."
    )]
    Lead {
        /// Who leads: any device, as `glisson devices list` shows
        leader: DeviceName,
        /// Who follows: an active trocar. A simulated one is in nobody's hand, 5 mm before something soft (300 N/m)
        follower: DeviceName,
        /// How long [s]; until Ctrl-C when left out
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
        /// Motion of the follower for one of the leader: 0.1 to 3
        #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
        scale: f64,
        /// Ticks a second [Hz]: 100 to 4000
        #[arg(long, value_name = "HZ", default_value_t = 1000.0)]
        rate: f64,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Look for what devices need: libraries, services, boards, real-time scheduling
    #[command(
        after_help = "Examples:\n  glisson devices doctor\n  glisson devices doctor --trocar 10.0.0.7:4000"
    )]
    Doctor {
        /// Where Haply's service listens
        #[arg(long, value_name = "HOST:PORT", default_value = HAPLY_ADDRESS)]
        haply: String,
        /// Where the board of an active trocar listens
        #[arg(long, value_name = "HOST:PORT", value_parser = host_and_port)]
        trocar: Option<String>,
    },
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.verb {
        Verb::List => {
            let width = KINDS.iter().map(|kind| kind.pattern.len()).max().unwrap_or(0);
            for kind in KINDS {
                println!("{:width$}  {}", kind.pattern, kind.about);
            }
            println!("\nOptions of a trocar: {OPTIONS}");
            Ok(())
        }
        Verb::Test { name, seconds, rate, json } => test(name, *seconds, *rate, *json),
        Verb::Lead { leader, follower, seconds, scale, rate, json } => {
            lead(&LeadRequest { leader, follower, seconds: *seconds, scale: *scale, rate_hz: *rate }, *json)
        }
        Verb::Doctor { haply, trocar } => {
            doctor(haply, trocar.as_deref());
            Ok(())
        }
    }
}

fn lead(request: &LeadRequest, as_json: bool) -> anyhow::Result<()> {
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    // Ends with the program: Ctrl-C may never come.
    std::thread::spawn(move || {
        if let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() {
            runtime.block_on(stop_signal());
            seen.store(true, Ordering::Relaxed);
        }
    });
    let report = lead::run(request, &stop)?;
    if as_json {
        println!("{:#}", report.to_json());
    } else {
        println!("{}", report.to_text());
    }
    report.check()
}

/// What was read.
#[derive(Default)]
struct Readings {
    n_good: u64,
    n_changes: u64,
    faults: Vec<(String, u64)>,
    least_m: Option<DVec3>,
    greatest_m: DVec3,
    fastest_m_per_s: f64,
    buttons_seen: u32,
    read: Histogram,
}

fn test(name: &DeviceName, seconds: f64, rate_hz: f64, as_json: bool) -> anyhow::Result<()> {
    ensure!(seconds > 0.0 && seconds <= 3_600.0, "--seconds {seconds}: must be above 0 and at most 3600");
    ensure!((10.0..=4_000.0).contains(&rate_hz), "--rate {rate_hz}: must be 10 to 4000 Hz");
    let home = ToolInput::at(DVec3::ZERO, DVec3::Z);
    let mut opened = devices::open(name, &home, rate_hz)?;
    let page = opened.page.take().map(DevicePage::start).transpose()?;
    if let Some(page) = &page {
        page.wait_for(opened.device.as_mut())?;
    }
    let scheduling = make_punctual(OwnCore::Last);
    let readings = read_for(&mut opened, seconds, rate_hz);
    let findings = Findings {
        device: &opened.name,
        readings: &readings,
        limits: opened.device.limits(),
        inserted: opened.device.inserted(),
        scheduling: &scheduling.text,
    };
    if as_json {
        println!("{:#}", findings.to_json());
    } else {
        findings.print();
    }
    ensure!(
        readings.n_good > 0,
        "the device {} never told where it is: {}",
        opened.name,
        first_reason(&readings)
    );
    Ok(())
}

/// Reads a device at a fixed rate, without any force.
fn read_for(opened: &mut OpenDevice, seconds: f64, rate_hz: f64) -> Readings {
    let mut readings = Readings::default();
    let period_ns = (1e9 / rate_hz) as u64;
    let mut last = None;
    let start_ns = now_ns();
    for tick in 1..=(seconds * rate_hz) as u64 {
        let begun_ns = now_ns();
        match opened.device.read() {
            Ok(state) => readings.add(&state, &mut last),
            Err(DeviceFault::Lost(why) | DeviceFault::Failed(why)) => {
                match readings.faults.iter_mut().find(|(text, _)| *text == why) {
                    Some((_, n)) => *n += 1,
                    None => readings.faults.push((why.into_owned(), 1)),
                }
            }
        }
        readings.read.record(now_ns() - begun_ns);
        // No force: this only looks.
        let _ = opened.device.write(&ForceCommand::default());
        wait_until(start_ns + tick * period_ns);
    }
    readings
}

impl Readings {
    /// Counts a good reading; `last` is the place of the one before.
    fn add(&mut self, state: &DeviceState, last: &mut Option<DVec3>) {
        self.n_good += 1;
        self.n_changes += u64::from(last.is_some_and(|last| last != state.position_m));
        *last = Some(state.position_m);
        self.least_m = Some(self.least_m.map_or(state.position_m, |m| m.min(state.position_m)));
        self.greatest_m =
            if self.n_good == 1 { state.position_m } else { self.greatest_m.max(state.position_m) };
        self.fastest_m_per_s = self.fastest_m_per_s.max(state.velocity_m_per_s.length());
        self.buttons_seen |= state.buttons;
    }
}

/// What a test found.
struct Findings<'a> {
    device: &'a str,
    readings: &'a Readings,
    limits: DeviceLimits,
    inserted: Option<InsertedInstrument>,
    scheduling: &'a str,
}

impl Findings<'_> {
    fn to_json(&self) -> serde_json::Value {
        let faults: Vec<_> =
            self.readings.faults.iter().map(|(why, n)| json!({ "reason": why, "ticks": n })).collect();
        json!({
            "device": self.device, "good_ticks": self.readings.n_good, "changes": self.readings.n_changes, "faults": faults,
            "least_m": self.readings.least_m.unwrap_or_default().to_array(), "greatest_m": self.readings.greatest_m.to_array(),
            "fastest_m_per_s": self.readings.fastest_m_per_s, "buttons_seen": self.readings.buttons_seen, "read_us": self.readings.read.percentiles().to_json(1e3),
            "limits": {
                "force_n": self.limits.force_n, "torque_n_m": self.limits.torque_n_m,
                "jaw_force_n": self.limits.jaw_force_n,
                "stiffness_n_per_m": self.limits.stiffness_n_per_m, "resolution_m": self.limits.resolution_m,
                "loop_delay_ticks": self.limits.loop_delay_ticks,
            },
            "instrument": self.inserted.map(|i| json!({ "name": i.name, "number": i.serial })),
            "scheduling": self.scheduling,
        })
    }

    fn print(&self) {
        println!("device       {}", self.device);
        if let Some(InsertedInstrument { name, serial }) = self.inserted {
            println!("instrument   {name}, number {serial}");
        }
        println!(
            "ticks        {} good; its place changed {} times",
            self.readings.n_good, self.readings.n_changes
        );
        for (why, n) in &self.readings.faults {
            println!("lost         {n} ticks: {why}");
        }
        let range_mm = (self.readings.greatest_m - self.readings.least_m.unwrap_or_default()) * 1e3;
        println!(
            "moved        over {:.2} x {:.2} x {:.2} mm, at most {:.3} m/s",
            range_mm.x, range_mm.y, range_mm.z, self.readings.fastest_m_per_s
        );
        println!("buttons      seen pressed: {:#b}", self.readings.buttons_seen);
        println!("a read       {} us", self.readings.read.percentiles().to_json(1e3));
        println!(
            "limits       {} N, {} N/m, sees {} mm",
            self.limits.force_n,
            self.limits.stiffness_n_per_m,
            self.limits.resolution_m * 1e3
        );
        println!("scheduling   {}", self.scheduling);
    }
}

fn first_reason(readings: &Readings) -> &str {
    readings.faults.first().map_or("no reason given", |(why, _)| why.as_str())
}

fn doctor(haply: &str, trocar: Option<&str>) {
    let say = |is_good: bool, what: &str, text: &str| {
        println!("{} {what:28} {text}", if is_good { "ok     " } else { "missing" });
    };
    for finding in devices::examine(haply, trocar) {
        say(finding.is_good, &finding.what, &finding.text);
    }
    let has_page = has_page();
    let page = if has_page {
        "built into this program; `glisson devices test viewer` tries it"
    } else {
        "not built into this program: `cargo xtask demo` builds it"
    };
    say(has_page, "viewer's page", page);
    // In its own thread: it stays as it is put.
    if let Ok((scheduling, late_ns)) =
        std::thread::spawn(|| (make_punctual(OwnCore::Last), lateness_ns())).join()
    {
        say(scheduling.is_real_time, "real-time scheduling", &scheduling.text);
        let late_us = late_ns as f64 * 1e-3;
        say(
            late_us < 100.0,
            "punctual timer",
            &format!("ticks of 1 ms begin at most {late_us:.0} us late in 99.9 %"),
        );
    }
    println!("\nA device that is missing here can be tried all the same: glisson devices test NAME");
}

/// How late ticks of a millisecond begin over half a second, in 99.9 %.
fn lateness_ns() -> u64 {
    let late = Histogram::default();
    let start_ns = now_ns();
    for tick in 1..=500 {
        let deadline_ns = start_ns + tick * 1_000_000;
        wait_until(deadline_ns);
        late.record(now_ns() - deadline_ns);
    }
    late.percentiles().p999_ns
}
