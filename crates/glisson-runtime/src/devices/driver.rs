//! A device whose calls wait (a network, a bus, a vendor's library) in a thread of its own: the haptic loop sees the latest
//! state and leaves the latest force, and never waits.

use crate::exchange::{Latest, Publisher, exchange};
use crate::realtime::{enter_real_time_class, now_ns, wait_until};
use anyhow::Context;
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// A state older than this is no state: twenty ticks of the loop [ns].
const LONGEST_SILENCE_NS: u64 = 20_000_000;
/// Ticks that the thread adds: one until its next turn takes a command, one until the loop looks at the state of the turn after
/// it. Both at most, for a device that is talked to as often as the loop ticks.
const THREAD_DELAY_TICKS: usize = 2;
/// When the answer before the first one was given.
const NOT_YET_NS: u64 = 0;
/// A force that nobody renewed for so long is withdrawn: the haptic loop has stopped [ns].
const LONGEST_FORCE_NS: u64 = 50_000_000;

/// One turn of talking to a device. It may wait for as long as the device takes.
pub(super) trait Line: Send + 'static {
    /// Gives the force, answers with the state. Reasons are fixed texts: the haptic loop copies them in every tick.
    ///
    /// # Errors
    /// [`DeviceFault::Lost`] is tried again, [`DeviceFault::Failed`] ends the driver.
    fn turn(&mut self, command: &ForceCommand) -> Result<DeviceState, DeviceFault>;

    /// Turns a second at most; none where the device itself paces them.
    fn most_turns_hz(&self) -> Option<f64>;
}

type Answer = (Result<DeviceState, DeviceFault>, u64);

/// A device behind a thread.
pub(super) struct ThreadedDevice {
    limits: DeviceLimits,
    answers: Latest<Answer>,
    commands: Publisher<(ForceCommand, u64)>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl ThreadedDevice {
    /// Starts the thread; `name` is for its name.
    pub(super) fn start(name: &str, limits: DeviceLimits, line: impl Line) -> anyhow::Result<Self> {
        let waiting = Err(DeviceFault::Lost("it has not answered yet".into()));
        let (answers_in, answers) = exchange((waiting, NOT_YET_NS));
        let (commands, commands_out) = exchange((ForceCommand::default(), 0));
        let stop = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || run(line, answers_in, commands_out, &seen))
            .with_context(|| format!("starting the thread of the device {name}"))?;
        let limits =
            DeviceLimits { loop_delay_ticks: limits.loop_delay_ticks + THREAD_DELAY_TICKS, ..limits };
        Ok(Self { limits, answers, commands, stop, thread: Some(thread) })
    }
}

fn run(
    mut line: impl Line,
    mut answers: Publisher<Answer>,
    mut commands: Latest<(ForceCommand, u64)>,
    stop: &AtomicBool,
) {
    // Where it is not allowed the device is less punctual; `glisson devices doctor` tells.
    let _ = enter_real_time_class();
    let mut next_ns = now_ns();
    while !stop.load(Ordering::Relaxed) {
        let (command, given_ns) = commands.get();
        let is_fresh = now_ns().saturating_sub(given_ns) < LONGEST_FORCE_NS;
        let answer = line.turn(&if is_fresh { command } else { ForceCommand::default() });
        let has_failed = matches!(answer, Err(DeviceFault::Failed(_)));
        answers.publish((answer, now_ns()));
        if has_failed {
            return;
        }
        if let Some(rate_hz) = line.most_turns_hz() {
            next_ns = (next_ns + (1e9 / rate_hz) as u64).max(now_ns().saturating_sub(1));
            wait_until(next_ns);
        }
    }
    // The hand is let go; who does not answer any more goes to zero by itself.
    let _ = line.turn(&ForceCommand::default());
}

impl HapticDevice for ThreadedDevice {
    fn limits(&self) -> DeviceLimits {
        self.limits
    }

    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        let (answer, at_ns) = self.answers.get();
        match answer {
            Ok(_) if now_ns().saturating_sub(at_ns) > LONGEST_SILENCE_NS => {
                Err(DeviceFault::Lost("nothing new from it for 20 ms".into()))
            }
            answer => answer,
        }
    }

    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        self.commands.publish((*command, now_ns()));
        // A line that is lost takes nothing; one that begins takes it with its first turn.
        match self.answers.get() {
            (_, NOT_YET_NS) => Ok(()),
            (answer, _) => answer.map(|_| ()),
        }
    }
}

impl Drop for ThreadedDevice {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the driver was printed when it happened.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DVec3;
    use std::sync::mpsc::{Sender, channel};
    use std::time::{Duration, Instant};

    const LIMITS: DeviceLimits = DeviceLimits {
        force_n: 5.0,
        torque_n_m: 0.0,
        force_rate_n_per_s: 5_000.0,
        stiffness_n_per_m: 500.0,
        damping_n_s_per_m: 5.0,
        resolution_m: 1e-5,
        rate_hz: 1_000.0,
        ..DeviceLimits::NONE
    };

    struct Scripted {
        n_turns: u64,
        forces: Sender<DVec3>,
        hangs_at: u64,
        fails_at: u64,
    }

    impl Line for Scripted {
        fn turn(&mut self, command: &ForceCommand) -> Result<DeviceState, DeviceFault> {
            self.n_turns += 1;
            // The test may have seen enough.
            let _ = self.forces.send(command.force_n);
            if self.n_turns == self.hangs_at {
                std::thread::sleep(Duration::from_millis(120));
            }
            if self.n_turns == self.fails_at {
                return Err(DeviceFault::Failed("broken".into()));
            }
            Ok(DeviceState {
                position_m: DVec3::X * self.n_turns as f64,
                velocity_m_per_s: DVec3::ZERO,
                orientation: None,
                jaw_opening: 0.0,
                buttons: 0,
            })
        }

        fn most_turns_hz(&self) -> Option<f64> {
            Some(1_000.0)
        }
    }

    fn until(device: &mut ThreadedDevice, what: impl Fn(&Result<DeviceState, DeviceFault>) -> bool) {
        let start = Instant::now();
        loop {
            let begun = Instant::now();
            let answer = device.read();
            assert!(begun.elapsed() < Duration::from_millis(50), "a read waited");
            if what(&answer) {
                return;
            }
            assert!(start.elapsed() < Duration::from_secs(10), "{answer:?}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn a_silent_device_is_lost_and_comes_back_and_one_that_fails_does_not() {
        let (forces, _seen) = channel();
        let line = Scripted { n_turns: 0, forces, hangs_at: 20, fails_at: 400 };
        let mut device = ThreadedDevice::start("scripted", LIMITS, line).unwrap();
        assert_eq!(device.limits(), DeviceLimits { loop_delay_ticks: 2, ..LIMITS });
        until(&mut device, Result::is_ok);
        until(&mut device, |a| *a == Err(DeviceFault::Lost("nothing new from it for 20 ms".into())));
        until(&mut device, Result::is_ok);
        until(&mut device, |a| *a == Err(DeviceFault::Failed("broken".into())));
    }

    #[test]
    fn a_force_is_given_renewed_and_taken_back_when_nobody_renews_it() {
        let (forces, seen) = channel();
        let line = Scripted { n_turns: 0, forces, hangs_at: 0, fails_at: 0 };
        let mut device = ThreadedDevice::start("scripted", LIMITS, line).unwrap();
        let wait_for = |force: DVec3| loop {
            if seen.recv_timeout(Duration::from_secs(10)).unwrap() == force {
                break;
            }
        };
        device.write(&ForceCommand { force_n: DVec3::Y, ..ForceCommand::default() }).unwrap();
        wait_for(DVec3::Y);
        wait_for(DVec3::ZERO);
        device.write(&ForceCommand { force_n: DVec3::Z, ..ForceCommand::default() }).unwrap();
        wait_for(DVec3::Z);
        drop(device);
        assert_eq!(seen.iter().last(), Some(DVec3::ZERO));
    }
}
