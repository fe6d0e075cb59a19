//! Force Dimension devices (omega, delta, sigma, lambda) and the Novint Falcon through the maker's library `dhd`, version 3.
//! Metres, newtons; the device's frame is the maker's.
#![allow(unsafe_code, reason = "a C library's functions")]

use super::driver::{Line, ThreadedDevice};
use super::kind::{DeviceChoice, DeviceKind, OpenRequest, nothing_after};
use super::vendor::{VendorLibrary, function};
use crate::open_device::OpenDevice;
use anyhow::{Context, ensure};
use glam::DQuat;
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use glisson::math::{DMat3, DVec3};
use libloading::Library;
use std::ffi::{CStr, c_char, c_double, c_int, c_uint};
use std::path::Path;
use std::sync::Arc;

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "force-dimension",
    pattern: "force-dimension",
    about: "omega, delta, sigma, lambda, Falcon through Force Dimension's library",
    parse: |rest| {
        nothing_after("force-dimension", rest).map(|()| Arc::new(ForceDimension) as Arc<dyn DeviceChoice>)
    },
    examine: Some(|_| LIBRARY.finding()),
};

#[derive(Debug)]
struct ForceDimension;

impl DeviceChoice for ForceDimension {
    fn text(&self) -> String {
        "Force Dimension's device".into()
    }

    fn open(&self, _: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        let (device, name) = open(None)?;
        Ok(OpenDevice {
            world_from_device: patient_from_force_dimension(),
            has_clutch: true,
            ..OpenDevice::new(device, &format!("Force Dimension {name}"))
        })
    }
}

/// Axes of patients from those of Force Dimension's devices: their +x to the user is inferior, +y to his right is the
/// patient's left, +z up is anterior, for a user who looks at a supine patient from the feet.
pub(super) fn patient_from_force_dimension() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Z, DVec3::X, DVec3::NEG_Y))
}

const LIBRARY: VendorLibrary = VendorLibrary {
    name: "Force Dimension (dhd)",
    variable: "GLISSON_DHD_LIBRARY",
    file_names: &["libdhd.so.3", "libdhd.so", "libdrd.so.3", "libdrd.so"],
    source: "Force Dimension's SDK",
};

/// A choice on the careful side for the weakest of them, the Falcon; the law keeps within it.
const LIMITS: DeviceLimits = DeviceLimits {
    force_n: 8.0,
    torque_n_m: 0.0,
    force_rate_n_per_s: 5_000.0,
    stiffness_n_per_m: 1_000.0,
    damping_n_s_per_m: 5.0,
    resolution_m: 5e-5,
    rate_hz: 1_000.0,
    ..DeviceLimits::NONE
};
/// Force and way of a gripper where a device has one: a choice on the careful side.
const GRIPPER: DeviceLimits = DeviceLimits { jaw_force_n: 4.0, jaw_travel_m: 0.025, ..LIMITS };
/// Angle of an open gripper, a choice: the makers' grippers open to about 30 degrees [rad].
const OPEN_GRIPPER_RAD: f64 = 0.5;
/// Twice the usual rate of the haptic loop: a state is half a tick old at most.
const TURNS_HZ: f64 = 2_000.0;

type OfDevice = unsafe extern "C" fn(c_char) -> c_int;
type Vector = unsafe extern "C" fn(*mut c_double, *mut c_double, *mut c_double, c_char) -> c_int;
type Scalar = unsafe extern "C" fn(*mut c_double, c_char) -> c_int;
type Matrix = unsafe extern "C" fn(*mut [[c_double; 3]; 3], c_char) -> c_int;
type SetAll = unsafe extern "C" fn(
    c_double,
    c_double,
    c_double,
    c_double,
    c_double,
    c_double,
    c_double,
    c_char,
) -> c_int;

/// The functions of the library that are used, as its header `dhdc.h` declares them. A `bool` is read as a byte.
struct Dhd {
    open: unsafe extern "C" fn() -> c_int,
    close: OfDevice,
    has_wrist: unsafe extern "C" fn(c_char) -> u8,
    has_gripper: unsafe extern "C" fn(c_char) -> u8,
    name: unsafe extern "C" fn(c_char) -> *const c_char,
    enable_force: unsafe extern "C" fn(u8, c_char) -> c_int,
    position: Vector,
    velocity: Vector,
    orientation: Matrix,
    gripper_angle: Scalar,
    buttons: unsafe extern "C" fn(c_char) -> c_uint,
    set_force: SetAll,
    error: unsafe extern "C" fn() -> *const c_char,
    /// Last, so that it is unloaded after everything else is gone.
    _library: Library,
}

impl Dhd {
    fn load(path: Option<&Path>) -> anyhow::Result<Self> {
        let (library, path) = LIBRARY.load(path)?;
        let context = || path.display().to_string();
        // SAFETY: the types are those of the header `dhdc.h`, version 3; the library lives as long as the addresses.
        let dhd = unsafe {
            Self {
                open: function(&library, "dhdOpen").with_context(context)?,
                close: function(&library, "dhdClose").with_context(context)?,
                has_wrist: function(&library, "dhdHasWrist").with_context(context)?,
                has_gripper: function(&library, "dhdHasGripper").with_context(context)?,
                name: function(&library, "dhdGetSystemName").with_context(context)?,
                enable_force: function(&library, "dhdEnableForce").with_context(context)?,
                position: function(&library, "dhdGetPosition").with_context(context)?,
                velocity: function(&library, "dhdGetLinearVelocity").with_context(context)?,
                orientation: function(&library, "dhdGetOrientationFrame").with_context(context)?,
                gripper_angle: function(&library, "dhdGetGripperAngleRad").with_context(context)?,
                buttons: function(&library, "dhdGetButtonMask").with_context(context)?,
                set_force: function(&library, "dhdSetForceAndTorqueAndGripperForce").with_context(context)?,
                error: function(&library, "dhdErrorGetLastStr").with_context(context)?,
                _library: library,
            }
        };
        Ok(dhd)
    }

    fn last_error(&self) -> String {
        // SAFETY: the function takes nothing and answers a string of its own, or null.
        text_of(unsafe { (self.error)() })
    }
}

fn text_of(text: *const c_char) -> String {
    if text.is_null() {
        return "unknown".into();
    }
    // SAFETY: not null, and the library's strings end with a zero and live for ever.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

struct DhdLine {
    dhd: Dhd,
    id: c_char,
    has_wrist: bool,
    has_gripper: bool,
}

/// Opens the first device that is free.
fn open(library: Option<&Path>) -> anyhow::Result<(Box<dyn HapticDevice>, String)> {
    let dhd = Dhd::load(library)?;
    // SAFETY: takes nothing; answers a number of the device, or below zero.
    let id = unsafe { (dhd.open)() };
    ensure!(id >= 0, "no Force Dimension device could be opened: {}", dhd.last_error());
    let id = c_char::try_from(id).context("the library's number of the device")?;
    // SAFETY: the device is open; these answer about it.
    let (has_wrist, has_gripper, name) =
        unsafe { ((dhd.has_wrist)(id) != 0, (dhd.has_gripper)(id) != 0, text_of((dhd.name)(id))) };
    // The line closes the device when it is dropped, also if forces cannot be switched on.
    let line = DhdLine { dhd, id, has_wrist, has_gripper };
    // SAFETY: the device is open.
    let enabled = unsafe { (line.dhd.enable_force)(1, id) };
    ensure!(enabled >= 0, "{name}: forces cannot be switched on: {}", line.dhd.last_error());
    let limits = if has_gripper { GRIPPER } else { LIMITS };
    Ok((Box::new(ThreadedDevice::start("force-dimension", limits, line)?), name))
}

impl DhdLine {
    fn vector(&self, of: Vector) -> Option<DVec3> {
        let mut v = [0.0; 3];
        let [x, y, z] = &mut v;
        // SAFETY: three places to write to; the device is open.
        let code = unsafe { of(x, y, z, self.id) };
        // Above zero are remarks: called too soon, for instance.
        (code >= 0).then(|| DVec3::from_array(v))
    }
}

impl Line for DhdLine {
    fn turn(&mut self, command: &ForceCommand) -> Result<DeviceState, DeviceFault> {
        let lost = |reason: &'static str| DeviceFault::Lost(reason.into());
        let (f, t) = (command.force_n, command.torque_n_m);
        // SAFETY: the device is open; numbers only.
        let code =
            unsafe { (self.dhd.set_force)(f.x, f.y, f.z, t.x, t.y, t.z, command.jaw_force_n, self.id) };
        if code < 0 {
            return Err(lost("it takes no force: is it switched on and its force button pressed?"));
        }
        let position_m = self.vector(self.dhd.position).ok_or_else(|| lost("it does not tell its place"))?;
        let velocity_m_per_s = self.vector(self.dhd.velocity).unwrap_or(DVec3::ZERO);
        let mut orientation = None;
        if self.has_wrist {
            let mut rows = [[0.0; 3]; 3];
            // SAFETY: nine places to write to; the device is open.
            let code = unsafe { (self.dhd.orientation)(&raw mut rows, self.id) };
            let matrix = DMat3::from_cols_array_2d(&rows).transpose();
            if code < 0 || !(matrix.determinant() - 1.0).abs().le(&0.1) {
                return Err(lost("it does not tell its orientation"));
            }
            orientation = Some(glam::DQuat::from_mat3(&matrix).normalize());
        }
        let mut jaw_opening = 1.0;
        if self.has_gripper {
            let mut angle_rad = 0.0;
            // SAFETY: one place to write to; the device is open.
            if unsafe { (self.dhd.gripper_angle)(&raw mut angle_rad, self.id) } >= 0 {
                jaw_opening = (angle_rad.abs() / OPEN_GRIPPER_RAD).clamp(0.0, 1.0);
            }
        }
        // SAFETY: the device is open.
        let buttons = unsafe { (self.dhd.buttons)(self.id) };
        Ok(DeviceState { position_m, velocity_m_per_s, orientation, jaw_opening, buttons })
    }

    fn most_turns_hz(&self) -> Option<f64> {
        Some(TURNS_HZ)
    }
}

impl Drop for DhdLine {
    fn drop(&mut self) {
        // SAFETY: the device was opened and is not used afterwards.
        unsafe { (self.dhd.close)(self.id) };
    }
}

#[cfg(test)]
mod tests {
    use super::super::vendor::tests::compiled;
    use super::*;
    use std::time::{Duration, Instant};

    /// Turns about z by 0.1 rad, moves with every question; remembers the last force and whether it was closed.
    const FAKE: &str = r#"
        #include <math.h>
        static double seen[7]; static int closed, questions, enabled;
        int dhdOpen(void) { return FAKE_OPEN; }
        int dhdClose(char id) { closed = 1 + id; return 0; }
        _Bool dhdHasWrist(char id) { return 1; }
        _Bool dhdHasGripper(char id) { return 1; }
        const char *dhdGetSystemName(char id) { return "fake.3"; }
        int dhdEnableForce(unsigned char on, char id) { enabled = on; return 0; }
        int dhdGetPosition(double *x, double *y, double *z, char id) {
            questions++; *x = 0.001 * questions; *y = -0.02; *z = 0.03; return questions > 200 ? -1 : 0; }
        int dhdGetLinearVelocity(double *x, double *y, double *z, char id) { *x = 0.5; *y = 0; *z = 0; return 1; }
        int dhdGetOrientationFrame(double m[3][3], char id) {
            double c = 0.99500416527802577, s = 0.09983341664682815;
            double f[3][3] = {{c, -s, 0}, {s, c, 0}, {0, 0, 1}};
            for (int i = 0; i < 9; i++) m[i / 3][i % 3] = f[i / 3][i % 3];
            return 0; }
        int dhdGetGripperAngleRad(double *a, char id) { *a = -0.25; return 0; }
        unsigned dhdGetButtonMask(char id) { return 5; }
        int dhdSetForceAndTorqueAndGripperForce(double a, double b, double c, double d, double e, double f, double g, char id) {
            double all[7] = {a, b, c, d, e, f, g};
            for (int i = 0; i < 7; i++) seen[i] = all[i];
            return enabled ? 0 : -1; }
        const char *dhdErrorGetLastStr(void) { return "no device found"; }
        double fake_seen(int i) { return i < 7 ? seen[i] : closed; }
    "#;

    #[test]
    fn a_device_without_a_wrist_tells_no_orientation() {
        let without = "dhdHasWrist(char id) { return 0; }";
        let source = FAKE.replace("FAKE_OPEN", "0").replace("dhdHasWrist(char id) { return 1; }", without);
        assert!(source.contains(without));
        let (_folder, path) = compiled(&source);
        let (mut device, _) = open(Some(&path)).unwrap();
        let start = Instant::now();
        let state = loop {
            assert!(start.elapsed() < Duration::from_secs(20));
            if let Ok(state) = device.read() {
                break state;
            }
            std::thread::sleep(Duration::from_micros(200));
        };
        assert_eq!(state.orientation, None);
    }

    #[test]
    fn a_device_is_read_pushed_lost_and_closed() {
        let (_folder, path) = compiled(&FAKE.replace("FAKE_OPEN", "0"));
        // The same file once more: the same statics.
        let (library, _) = LIBRARY.load(Some(&path)).unwrap();
        // SAFETY: the type is the source's.
        let seen: extern "C" fn(c_int) -> c_double = unsafe { function(&library, "fake_seen") }.unwrap();
        let (mut device, name) = open(Some(&path)).unwrap();
        assert_eq!(name, "fake.3");
        let command = ForceCommand {
            force_n: DVec3::new(1.0, -2.0, 3.0),
            torque_n_m: DVec3::new(0.1, 0.2, 0.3),
            jaw_force_n: 0.5,
        };
        let start = Instant::now();
        let mut state = None;
        let reason = loop {
            assert!(start.elapsed() < Duration::from_secs(20), "{state:?}");
            device.write(&command).unwrap();
            std::thread::sleep(Duration::from_micros(200));
            match device.read() {
                Ok(now) => state = Some(now),
                Err(DeviceFault::Lost(reason)) if state.is_some() && reason.contains("place") => {
                    break reason;
                }
                Err(_) => {}
            }
        };
        assert_eq!(reason, "it does not tell its place");
        let state = state.unwrap();
        assert!(
            state.position_m.x > 0.0 && (state.position_m.y, state.position_m.z) == (-0.02, 0.03),
            "{state:?}"
        );
        assert!(
            state.orientation.unwrap().abs_diff_eq(glam::DQuat::from_rotation_z(0.1), 1e-12),
            "{state:?}"
        );
        assert_eq!((state.velocity_m_per_s.x, state.jaw_opening, state.buttons), (0.5, 0.5, 5));
        assert_eq!([0, 1, 2, 3, 4, 5, 6].map(|i| seen(i)), [1.0, -2.0, 3.0, 0.1, 0.2, 0.3, 0.5]);
        drop(device);
        assert_eq!([0, 1, 2, 6, 7].map(|i| seen(i)), [0.0, 0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn no_device_and_an_old_library_are_told() {
        let (_folder, path) = compiled(&FAKE.replace("FAKE_OPEN", "-1"));
        let error = open(Some(&path)).err().unwrap().to_string();
        assert!(error.contains("no device found"), "{error}");
        let (_folder, path) = compiled("int dhdOpen(void) { return 0; }");
        let error = format!("{:#}", open(Some(&path)).err().unwrap());
        assert!(error.contains("no function dhdClose") && error.contains("libfake.so"), "{error}");
    }
}
