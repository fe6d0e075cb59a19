//! Pages that look at a simulation which another program steps.

use super::access::Access;
use super::{Shared, bind, page_address, serve_pages};
use anyhow::Context;
use glisson_protocol::conversation::Room;
use glisson_protocol::hands::{self, Hands};
use glisson_protocol::messages::{self, HapticsAt};
use glisson_runtime::Simulation;
use glisson_runtime::haptic_loop::HapticSettings;
use glisson_runtime::passive::{Asked, Passive};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::oneshot;

/// Who looked and went may come back in this time: a page that is loaded again. A choice.
const COMES_BACK: Duration = Duration::from_secs(10);

/// Pages before a simulation, served by a thread of their own until this is dropped.
pub struct PassiveServer {
    passive: Passive,
    shared: Arc<Shared>,
    address: String,
    teacher_address: String,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl PassiveServer {
    /// Serves pages on `host` and `port` (0: any free one), for who has the `token` where the address is not this machine's own.
    ///
    /// # Errors
    /// An address that cannot be taken, a token that is too short, no thread.
    pub fn start(
        simulation: &Simulation,
        host: &str,
        port: u16,
        token: Option<String>,
    ) -> anyhow::Result<Self> {
        let listener = bind(host, port)?;
        let address = listener.local_addr()?;
        let access = Access::for_address(address.ip(), token)?;
        let page = page_address(address) + &access.address_suffix();
        let teacher_address = page_address(address) + &access.teacher_suffix();
        let (commands, comes) = std::sync::mpsc::channel();
        let (passive, published) = Passive::start(simulation, comes)?;
        let (hello, devices) = (messages::hello(simulation), messages::devices(std::iter::empty()));
        let shared = Arc::new(Shared {
            room: Arc::new(Room::new(hello, devices, Hands::new(Vec::new(), None), false)),
            published,
            commands,
            meters: None,
            haptics_at: HapticsAt::Nowhere,
            remote_figures: None,
            homing: hands::homing(HapticSettings::default().rate_hz),
            leaving: None,
            compare: None,
        });
        let (stop, stops) = oneshot::channel();
        let served = Arc::clone(&shared);
        let serving = move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
            runtime.block_on(serve_pages(listener, served, access, async {
                // Dropped is stopped, too.
                let _ = stops.await;
            }))
        };
        let thread = std::thread::Builder::new().name("pages".into()).spawn(serving);
        let thread = Some(thread.context("starting the pages' thread")?);
        Ok(Self { passive, shared, address: page, teacher_address, stop: Some(stop), thread })
    }

    /// Where the page is.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Where it is for who teaches.
    pub fn teacher_address(&self) -> &str {
        &self.teacher_address
    }

    /// How many look.
    pub fn n_watchers(&self) -> usize {
        self.shared.room.class.watch().borrow().people.len()
    }

    /// Whether somebody looks, or may yet: false once all who looked have been gone for a while, and where the pages' thread ended.
    pub fn is_running(&self) -> bool {
        let may_come = self.shared.room.class.empty_since().is_none_or(|left| left.elapsed() < COMES_BACK);
        may_come && self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// What pages asked for up to the last [`PassiveServer::sync`].
    pub fn asked(&self) -> &Asked {
        self.passive.asked()
    }

    /// Lets go of an instrument that a page had moved.
    pub fn let_go(&mut self, tool: usize) {
        self.passive.let_go(tool);
    }

    /// As [`Passive::went_back`].
    pub fn went_back(&mut self) {
        self.passive.went_back();
    }

    /// As [`Passive::sync`].
    pub fn sync(&mut self, simulation: &mut Simulation) {
        self.passive.sync(simulation);
    }
}

impl Drop for PassiveServer {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            // Who ended already hears nothing.
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            // A panic was printed when it happened.
            let _ = thread.join();
        }
    }
}
