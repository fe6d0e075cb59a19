//! 3D Systems' Touch and Phantom devices through the maker's OpenHaptics library (HDAPI). The library speaks millimetres and
//! newtons and has a servo thread of its own, in which one turn of this driver runs.
#![allow(unsafe_code, reason = "a C library's functions")]

use super::driver::{Line, ThreadedDevice};
use super::kind::{DeviceChoice, DeviceKind, OpenRequest, after_colon, nothing_after};
use super::vendor::{VendorLibrary, function};
use crate::open_device::OpenDevice;
use anyhow::{Context, ensure};
use glisson::haptics::mapping::patient_from_desk;
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use glisson::math::{DMat3, DVec3};
use libloading::Library;
use std::ffi::{CStr, CString, c_char, c_double, c_int, c_uint, c_ushort, c_void};
use std::path::Path;
use std::sync::Arc;

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "openhaptics",
    pattern: "openhaptics[:NAME]",
    about: "3D Systems Touch, Phantom through the OpenHaptics library",
    parse: |rest| {
        let name = after_colon(rest);
        if name.is_none() {
            nothing_after("openhaptics", rest)?;
        }
        Ok(Arc::new(OpenHapticsChoice { name: name.map(str::to_owned) }))
    },
    examine: Some(|_| LIBRARY.finding()),
};

/// A device by its name in the maker's configuration; the default one for none.
#[derive(Debug)]
struct OpenHapticsChoice {
    name: Option<String>,
}

impl DeviceChoice for OpenHapticsChoice {
    fn text(&self) -> String {
        format!("OpenHaptics {}", self.name.as_deref().unwrap_or("default device"))
    }

    fn open(&self, _: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        let (device, name) = open(self.name.as_deref(), None)?;
        Ok(OpenDevice {
            world_from_device: patient_from_desk(),
            has_clutch: true,
            ..OpenDevice::new(device, &format!("OpenHaptics {name}"))
        })
    }
}

const LIBRARY: VendorLibrary = VendorLibrary {
    name: "3D Systems OpenHaptics (HD)",
    variable: "GLISSON_HD_LIBRARY",
    file_names: &["libHD.so.3.4", "libHD.so.3", "libHD.so"],
    source: "3D Systems' OpenHaptics for Linux",
};

// Names and numbers of the library's header `hdDefines.h`.
const INVALID_HANDLE: c_uint = 0xFFFF_FFFF;
const CURRENT_BUTTONS: c_uint = 0x2000;
const CURRENT_VELOCITY: c_uint = 0x2051;
const CURRENT_TRANSFORM: c_uint = 0x2052;
const NOMINAL_MAX_STIFFNESS: c_uint = 0x2602;
const NOMINAL_MAX_FORCE: c_uint = 0x2603;
const CURRENT_FORCE: c_uint = 0x2700;
const FORCE_OUTPUT: c_uint = 0x4000;
const CALLBACK_DONE: c_uint = 0;
const DEFAULT_PRIORITY: c_ushort = 0x7FFF;

const MM_PER_M: f64 = 1e3;

/// `HDErrorInfo`.
#[repr(C)]
#[derive(Clone, Copy)]
struct ErrorInfo {
    code: c_uint,
    internal_code: c_int,
    device: c_uint,
}

type Callback = extern "C" fn(*mut c_void) -> c_uint;

/// The functions of the library that are used, as its header `hd.h` declares them.
#[derive(Clone, Copy)]
struct Functions {
    init: unsafe extern "C" fn(*const c_char) -> c_uint,
    disable_device: unsafe extern "C" fn(c_uint),
    make_current: unsafe extern "C" fn(c_uint),
    enable: unsafe extern "C" fn(c_uint),
    begin_frame: unsafe extern "C" fn(c_uint),
    end_frame: unsafe extern "C" fn(c_uint),
    get_doubles: unsafe extern "C" fn(c_uint, *mut c_double),
    get_integers: unsafe extern "C" fn(c_uint, *mut c_int),
    set_doubles: unsafe extern "C" fn(c_uint, *const c_double),
    schedule: unsafe extern "C" fn(Callback, *mut c_void, c_ushort),
    start_scheduler: unsafe extern "C" fn(),
    stop_scheduler: unsafe extern "C" fn(),
    last_error: unsafe extern "C" fn() -> ErrorInfo,
    error_text: unsafe extern "C" fn(c_uint) -> *const c_char,
}

fn functions(library: &Library) -> anyhow::Result<Functions> {
    // SAFETY: the types are those of the header `hd.h`.
    unsafe {
        Ok(Functions {
            init: function(library, "hdInitDevice")?,
            disable_device: function(library, "hdDisableDevice")?,
            make_current: function(library, "hdMakeCurrentDevice")?,
            enable: function(library, "hdEnable")?,
            begin_frame: function(library, "hdBeginFrame")?,
            end_frame: function(library, "hdEndFrame")?,
            get_doubles: function(library, "hdGetDoublev")?,
            get_integers: function(library, "hdGetIntegerv")?,
            set_doubles: function(library, "hdSetDoublev")?,
            schedule: function(library, "hdScheduleSynchronous")?,
            start_scheduler: function(library, "hdStartScheduler")?,
            stop_scheduler: function(library, "hdStopScheduler")?,
            last_error: function(library, "hdGetError")?,
            error_text: function(library, "hdGetErrorString")?,
        })
    }
}

impl Functions {
    /// Takes the oldest error off the library's stack.
    fn error(&self) -> Option<String> {
        // SAFETY: takes nothing, answers a plain struct.
        let error = unsafe { (self.last_error)() };
        if error.code == 0 {
            return None;
        }
        // SAFETY: answers a string of its own for any number, or null.
        let text = unsafe { (self.error_text)(error.code) };
        if text.is_null() {
            return Some(format!("error {:#06x}", error.code));
        }
        // SAFETY: not null; the library's strings end with a zero and live for ever.
        let text = unsafe { CStr::from_ptr(text) }.to_string_lossy();
        Some(format!("{text} ({:#06x})", error.code))
    }

    fn number(&self, which: c_uint) -> f64 {
        let mut value = [0.0; 16];
        // SAFETY: room for the largest answer that the library has.
        unsafe { (self.get_doubles)(which, value.as_mut_ptr()) };
        value[0]
    }
}

struct HdLine {
    functions: Functions,
    device: c_uint,
    /// Last, so that it is unloaded after everything else is gone.
    _library: Library,
}

/// Opens the device with this name in the maker's configuration; the default one for none.
fn open(name: Option<&str>, library: Option<&Path>) -> anyhow::Result<(Box<dyn HapticDevice>, String)> {
    let (library, path) = LIBRARY.load(library)?;
    let functions = functions(&library).with_context(|| path.display().to_string())?;
    let c_name = name.map(CString::new).transpose().context("the device's name")?;
    // SAFETY: a string that ends with a zero, or null for the default device.
    let device = unsafe { (functions.init)(c_name.as_ref().map_or(std::ptr::null(), |name| name.as_ptr())) };
    let error = functions.error();
    let shown = name.unwrap_or("the default device");
    ensure!(
        device != INVALID_HANDLE && error.is_none(),
        "{shown} could not be opened: {}",
        error.as_deref().unwrap_or("no reason given")
    );
    // From here on the line closes it.
    let line = HdLine { functions, device, _library: library };
    // SAFETY: the device is open.
    unsafe {
        (functions.make_current)(device);
        (functions.enable)(FORCE_OUTPUT);
        (functions.start_scheduler)();
    }
    if let Some(error) = functions.error() {
        anyhow::bail!("{shown}: its servo loop could not be started: {error}");
    }
    let limits = limits(functions.number(NOMINAL_MAX_FORCE), functions.number(NOMINAL_MAX_STIFFNESS));
    Ok((Box::new(ThreadedDevice::start("openhaptics", limits, line)?), shown.to_owned()))
}

/// What the device says of itself, within what the smallest of them can do.
fn limits(most_force_n: f64, stiffness_n_per_mm: f64) -> DeviceLimits {
    let sound = |value: f64, range: std::ops::RangeInclusive<f64>, otherwise: f64| {
        if range.contains(&value) { value } else { otherwise }
    };
    DeviceLimits {
        force_n: sound(most_force_n, 0.5..=40.0, 3.3),
        torque_n_m: 0.0,
        force_rate_n_per_s: 2_000.0,
        stiffness_n_per_m: MM_PER_M * sound(stiffness_n_per_mm, 0.05..=5.0, 0.5),
        damping_n_s_per_m: 2.0,
        resolution_m: 5.5e-5,
        rate_hz: 1_000.0,
        ..DeviceLimits::NONE
    }
}

/// What a turn in the servo thread takes and brings.
struct Turn {
    functions: Functions,
    device: c_uint,
    force_n: [f64; 3],
    /// Column by column, millimetres.
    transform: [f64; 16],
    velocity_mm_per_s: [f64; 3],
    buttons: c_int,
}

extern "C" fn servo_turn(turn: *mut c_void) -> c_uint {
    // SAFETY: `HdLine::turn` passes its own `Turn` and waits until this has returned; nobody else has it meanwhile.
    let turn = unsafe { &mut *turn.cast::<Turn>() };
    let functions = turn.functions;
    // SAFETY: in the servo thread, between begin and end of a frame; the arrays have the lengths that the header tells.
    unsafe {
        (functions.begin_frame)(turn.device);
        (functions.get_doubles)(CURRENT_TRANSFORM, turn.transform.as_mut_ptr());
        (functions.get_doubles)(CURRENT_VELOCITY, turn.velocity_mm_per_s.as_mut_ptr());
        (functions.get_integers)(CURRENT_BUTTONS, &raw mut turn.buttons);
        (functions.set_doubles)(CURRENT_FORCE, turn.force_n.as_ptr());
        (functions.end_frame)(turn.device);
    }
    CALLBACK_DONE
}

impl Line for HdLine {
    fn turn(&mut self, command: &ForceCommand) -> Result<DeviceState, DeviceFault> {
        let mut turn = Turn {
            functions: self.functions,
            device: self.device,
            force_n: command.force_n.to_array(),
            transform: [0.0; 16],
            velocity_mm_per_s: [0.0; 3],
            buttons: 0,
        };
        // SAFETY: the call returns after the callback has run; `turn` lives until then.
        unsafe { (self.functions.schedule)(servo_turn, (&raw mut turn).cast(), DEFAULT_PRIORITY) };
        if self.functions.error().is_some() {
            return Err(DeviceFault::Lost(
                "its library reports an error: is it connected and switched on?".into(),
            ));
        }
        let column = |i: usize| DVec3::from_slice(&turn.transform[4 * i..4 * i + 3]);
        let matrix = DMat3::from_cols(column(0), column(1), column(2));
        if !(matrix.determinant() - 1.0).abs().le(&0.1) {
            return Err(DeviceFault::Lost("it does not tell its orientation".into()));
        }
        let buttons = turn.buttons.cast_unsigned();
        Ok(DeviceState {
            position_m: column(3) / MM_PER_M,
            velocity_m_per_s: DVec3::from_array(turn.velocity_mm_per_s) / MM_PER_M,
            orientation: Some(glam::DQuat::from_mat3(&matrix).normalize()),
            // A stylus has no jaws: its second button closes the tool's.
            jaw_opening: if buttons & 2 == 0 { 1.0 } else { 0.0 },
            buttons,
        })
    }

    fn most_turns_hz(&self) -> Option<f64> {
        // The servo thread paces the turns.
        None
    }
}

impl Drop for HdLine {
    fn drop(&mut self) {
        // SAFETY: the device is open and not used afterwards.
        unsafe {
            (self.functions.stop_scheduler)();
            (self.functions.disable_device)(self.device);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::vendor::tests::compiled;
    use super::*;
    use std::time::{Duration, Instant};

    /// A stylus that moves by 1 mm a turn, turned about x by 90 degrees; each turn takes half a millisecond.
    const FAKE: &str = r#"
        #include <unistd.h>
        typedef struct { unsigned code; int internal; unsigned device; } Info;
        static double seen[3]; static int turns, in_frame, broken_frames, enabled, running, closed;
        unsigned hdInitDevice(const char *name) { return name && name[0] == 'x' ? 0xFFFFFFFFu : 7; }
        void hdDisableDevice(unsigned d) { closed = d; }
        void hdMakeCurrentDevice(unsigned d) {}
        void hdEnable(unsigned what) { if (what == 0x4000) enabled = 1; }
        void hdBeginFrame(unsigned d) { in_frame = d; turns++; }
        void hdEndFrame(unsigned d) { in_frame = 0; }
        void hdGetDoublev(unsigned what, double *v) {
            if (what == 0x2603) { v[0] = 3.3; return; }
            if (what == 0x2602) { v[0] = 0.4; return; }
            if (in_frame != 7) broken_frames++;
            if (what == 0x2051) { v[0] = 1000; v[1] = 0; v[2] = -500; }
            if (what == 0x2052) {
                double m[16] = {1, 0, 0, 0,  0, 0, 1, 0,  0, -1, 0, 0,  0, 20, -30, 1};
                for (int i = 0; i < 16; i++) v[i] = m[i];
                v[12] = turns; } }
        void hdGetIntegerv(unsigned what, int *v) { if (what == 0x2000) *v = 3; }
        void hdSetDoublev(unsigned what, const double *v) {
            if (what == 0x2700 && in_frame == 7 && enabled) for (int i = 0; i < 3; i++) seen[i] = v[i]; }
        void hdScheduleSynchronous(unsigned (*f)(void *), void *p, unsigned short priority) { usleep(500); if (running) f(p); }
        void hdStartScheduler(void) { running = 1; }
        void hdStopScheduler(void) { running = 0; }
        Info hdGetError(void) { Info i = {turns > 300 ? 0x0201 : 0, 0, 7}; return i; }
        const char *hdGetErrorString(unsigned code) { return "communication error"; }
        double fake_seen(int i) { return i < 3 ? seen[i] : i == 3 ? closed : broken_frames; }
    "#;

    #[test]
    fn a_device_is_read_pushed_lost_and_closed() {
        let (_folder, path) = compiled(FAKE);
        let (library, _) = LIBRARY.load(Some(&path)).unwrap();
        // SAFETY: the type is the source's.
        let seen: extern "C" fn(c_int) -> c_double = unsafe { function(&library, "fake_seen") }.unwrap();
        let (mut device, _) = open(None, Some(&path)).unwrap();
        let limits = device.limits();
        assert_eq!((limits.force_n, limits.stiffness_n_per_m), (3.3, 400.0));
        let start = Instant::now();
        let mut state = None;
        let (mut felt, command) =
            (false, ForceCommand { force_n: DVec3::new(1.0, -2.0, 3.0), ..Default::default() });
        loop {
            assert!(start.elapsed() < Duration::from_secs(20), "{state:?}");
            device.write(&command).unwrap();
            std::thread::sleep(Duration::from_micros(300));
            felt |= [0, 1, 2].map(|i| seen(i)) == [1.0, -2.0, 3.0];
            match device.read() {
                Ok(now) => state = Some(now),
                Err(DeviceFault::Lost(reason)) if reason.contains("library reports") => break,
                Err(_) => {}
            }
        }
        let state = state.unwrap();
        assert!(felt && state.position_m.x > 0.0, "{state:?}");
        assert!(
            state.position_m.abs_diff_eq(DVec3::new(state.position_m.x, 0.02, -0.03), 1e-12),
            "{state:?}"
        );
        assert!(state.velocity_m_per_s.abs_diff_eq(DVec3::new(1.0, 0.0, -0.5), 1e-12));
        let quarter = glam::DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
        assert!(state.orientation.unwrap().abs_diff_eq(quarter, 1e-12), "{state:?}");
        assert_eq!((state.jaw_opening, state.buttons), (0.0, 3));
        drop(device);
        assert_eq!([0, 1, 2, 3, 4].map(|i| seen(i)), [0.0, 0.0, 0.0, 7.0, 0.0]);
    }

    #[test]
    fn a_device_that_does_not_open_and_odd_limits_are_told_or_replaced() {
        let (_folder, path) = compiled(FAKE);
        let error = open(Some("x"), Some(&path)).err().unwrap().to_string();
        assert!(error.contains("x could not be opened"), "{error}");
        assert_eq!(limits(f64::NAN, -1.0).force_n, 3.3);
        assert_eq!(limits(7.9, 1.0).stiffness_n_per_m, 1_000.0);
    }
}
