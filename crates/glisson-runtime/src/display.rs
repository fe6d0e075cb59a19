//! From the simulation to all who show it: viewers, links to other programs.
//!
//! Those wait on a `watch` channel, whose readers hold a lock while they look and whose sender waits for them. The simulation
//! never does: it leaves what it publishes in an [`exchange`], of which a thread of its own takes the newest and sends it on.

use crate::exchange::{Latest, Publisher, exchange};
use crate::published::Published;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use tokio::sync::watch;

/// The simulation's end. Dropped, it sends on what was published last and closes the channel.
pub(crate) struct DisplayFeed {
    newest: Publisher<Arc<Published>>,
    is_over: Arc<AtomicBool>,
    relay: Option<JoinHandle<()>>,
}

impl DisplayFeed {
    /// Both ends; until something is published the newest state is `first`.
    ///
    /// # Errors
    /// When no thread can be started.
    pub(crate) fn start(first: Published) -> std::io::Result<(Self, watch::Receiver<Arc<Published>>)> {
        let first = Arc::new(first);
        let (channel, shown) = watch::channel(Arc::clone(&first));
        let (newest, arriving) = exchange(first);
        let is_over = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&is_over);
        let relay = std::thread::Builder::new()
            .name("display".into())
            .spawn(move || send_on(arriving, &channel, &seen))?;
        Ok((Self { newest, is_over, relay: Some(relay) }, shown))
    }

    /// Makes that the newest state; waits for nobody.
    pub(crate) fn publish(&mut self, state: Arc<Published>) {
        self.newest.publish(state);
    }
}

impl Drop for DisplayFeed {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
        if let Some(relay) = self.relay.take() {
            relay.thread().unpark();
            // A panic was printed when it happened.
            let _ = relay.join();
        }
    }
}

fn send_on(
    mut arriving: Latest<Arc<Published>>,
    channel: &watch::Sender<Arc<Published>>,
    is_over: &AtomicBool,
) {
    arriving.wakes(std::thread::current());
    loop {
        // Before looking, so that the last state is not left behind.
        let is_last_look = is_over.load(Ordering::Acquire);
        match arriving.get_new() {
            Some(state) => _ = channel.send_replace(state),
            None if is_last_look => return,
            // What came meanwhile has left a token: then this returns at once.
            None => std::thread::park(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{OpenScene, Simulation};
    use std::sync::mpsc;
    use std::time::{Duration, Instant};

    const MESH: &str = "4 1\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n0 1 2 3\n";
    const SCENE: &str = "glisson_scene = 1\n[organ]\nmodel = \"explicit\"\nmesh = \"body.tet\"\nyoung_modulus = \"5 kPa\"\n\
        poisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\ndamping = \"30 1/s\"\n\
        [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.6 }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n";

    fn state() -> Published {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("body.tet"), MESH).unwrap();
        std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        Published::first(&Simulation::open(source, None).unwrap(), &Arc::default())
    }

    fn at_step(first: &Published, step: u64) -> Published {
        let mut state = first.clone();
        state.snapshot.step = step;
        state
    }

    #[test]
    fn who_looks_for_long_does_not_hold_the_simulation_up_and_sees_the_newest_state_next() {
        let first = state();
        let (mut feed, mut shown) = DisplayFeed::start(first.clone()).unwrap();
        // A reader that does not let go.
        let held = shown.borrow();
        let (done_in, done) = mpsc::channel();
        let publishing = std::thread::spawn(move || {
            for step in 1..=20 {
                feed.publish(Arc::new(at_step(&first, step)));
            }
            done_in.send(()).unwrap();
            feed
        });
        done.recv_timeout(Duration::from_secs(20)).expect("the simulation goes on");
        assert_eq!(held.snapshot.step, 0);
        drop(held);
        let begin = Instant::now();
        while shown.borrow_and_update().snapshot.step < 20 {
            assert!(begin.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(1));
        }
        // The end is told, after the last state.
        let mut feed = publishing.join().unwrap();
        let last = at_step(&shown.borrow(), 21);
        feed.publish(Arc::new(last));
        drop(feed);
        assert_eq!(shown.borrow_and_update().snapshot.step, 21);
        assert!(shown.has_changed().is_err(), "closed");
    }
}
