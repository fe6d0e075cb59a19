//! The viewer's page with a small organ, for `glisson devices test viewer`.

use anyhow::{Context, ensure};
use glisson::haptics::HapticDevice;
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::files::write_mesh;
use glisson_lab::scratch::ScratchFolder;
use glisson_runtime::page_hand::PageHand;
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::server::access::Access;
use glisson_view::server::{self, Served, Service};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A block of soft tissue on a table, with a probe above it: choices.
const SIZE_M: [f64; 3] = [0.08, 0.08, 0.03];
const CELLS: [usize; 3] = [6, 6, 3];
const SCENE: &str = r#"glisson_scene = 1
name = "block for trying the page"
[simulation]
time_step = "0.5 ms"
[organ]
mesh = "block.vtu"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1000 kg/m3"
model = "tensor_mass"
damping = "30 1/s"
[[organ.fixed]]
furthest = { direction = [0, 0, -1], fraction = 0.1 }
[tool]
tip_radius = "5 mm"
home_tip = ["40 mm", "40 mm", "60 mm"]
home_shaft = [0, 0, 1]
"#;
/// How long nobody may come.
const PATIENCE: Duration = Duration::from_secs(120);

/// A running server; ends when dropped.
pub(super) struct DevicePage {
    address: String,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<JoinHandle<anyhow::Result<Served>>>,
}

impl DevicePage {
    /// Serves a page that tells `hand` what it does.
    ///
    /// # Errors
    /// When no server can be started.
    pub(super) fn start(hand: PageHand) -> anyhow::Result<Self> {
        let folder = ScratchFolder::new()?;
        write_mesh(&folder.path().join("block.vtu"), &box_of_five(CELLS, DVec3::from_array(SIZE_M)))?;
        let scene = folder.path().join("scene.toml");
        std::fs::write(&scene, SCENE).with_context(|| format!("{}: cannot write", scene.display()))?;
        let simulation = Simulation::open(OpenScene::read(&scene)?, None)?;
        let listener = server::bind("127.0.0.1", 0)?;
        let address = listener.local_addr()?;
        let access = Access::for_address(address.ip(), None)?;
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let thread = std::thread::Builder::new().name("page".into()).spawn(move || {
            let service = Service { beside: Some(hand), ..Service::to(access) };
            server::serve(simulation, listener, service, async {
                // Whether it is sent or dropped is the same.
                let _ = stopped.await;
            })
        })?;
        Ok(Self { address: server::page_address(address), stop: Some(stop), thread: Some(thread) })
    }

    /// Says where the page is, and waits until it is opened.
    ///
    /// # Errors
    /// When nobody opens it.
    pub(super) fn wait_for(&self, device: &mut dyn HapticDevice) -> anyhow::Result<()> {
        eprintln!("open {} in a browser and push the block: the test begins then", self.address);
        let start = Instant::now();
        while device.read().is_err() {
            ensure!(start.elapsed() < PATIENCE, "nobody opened {} within two minutes", self.address);
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

impl Drop for DevicePage {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // What it ended with does not matter any more.
            let _ = thread.join();
        }
    }
}
