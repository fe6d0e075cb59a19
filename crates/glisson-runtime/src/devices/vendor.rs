//! Libraries of device makers, loaded when the program runs if they are there. They are not part of the program and their
//! terms are their makers'.

use super::kind::Finding;
use anyhow::{Context, bail};
use libloading::Library;
use std::path::{Path, PathBuf};

/// Where a maker's library is looked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct VendorLibrary {
    /// Who makes it, and what it is for.
    pub(super) name: &'static str,
    /// Variable of the environment that names the file.
    pub(super) variable: &'static str,
    /// Names that the system's loader is asked for, the usual ones first.
    pub(super) file_names: &'static [&'static str],
    /// Where it comes from.
    pub(super) source: &'static str,
}

impl VendorLibrary {
    /// Whether it can be loaded.
    pub(super) fn finding(&self) -> Finding {
        let loaded = self.load(None).map(|(_, path)| format!("{} can be loaded", path.display()));
        Finding::of(self.name, loaded)
    }

    /// Files to try, in order: what the variable names, and nothing else then; otherwise the usual names.
    pub(super) fn candidates(&self) -> Vec<PathBuf> {
        match std::env::var_os(self.variable) {
            Some(path) => vec![path.into()],
            None => self.file_names.iter().map(PathBuf::from).collect(),
        }
    }

    /// Loads it from `path`, or from the first of the candidates that is there.
    ///
    /// # Errors
    /// When there is none, with what was tried and where it comes from.
    pub(super) fn load(&self, path: Option<&Path>) -> anyhow::Result<(Library, PathBuf)> {
        let candidates = path.map_or_else(|| self.candidates(), |path| vec![path.to_path_buf()]);
        let (mut tried, mut reason) = (Vec::new(), String::new());
        for candidate in candidates {
            match open(&candidate) {
                Ok(library) => return Ok((library, candidate)),
                Err(error) => {
                    tried.push(candidate.display().to_string());
                    reason = format!("{:#}", error.root_cause());
                }
            }
        }
        bail!(
            "the library of {} was not found (tried {}; the last one: {reason}); get it from {} and name the file in {}",
            self.name,
            tried.join(", "),
            self.source,
            self.variable
        )
    }
}

#[allow(unsafe_code, reason = "loading a maker's library runs its code")]
fn open(path: &Path) -> anyhow::Result<Library> {
    // SAFETY: loading runs the library's initialisers. The user installed or named this library as a device's driver; it
    // is trusted like any driver.
    unsafe { Library::new(path) }.context("cannot be loaded")
}

/// Copies a function's address out of a library.
///
/// # Errors
/// When the library has no such function.
///
/// # Safety
/// `F` must be the type that the library's header gives the function, as `extern "C"`, and must not be called after the
/// library is unloaded.
#[allow(unsafe_code, reason = "only the caller knows the function's type")]
pub(super) unsafe fn function<F: Copy>(library: &Library, name: &str) -> anyhow::Result<F> {
    // SAFETY: the caller vouches for the type.
    let symbol = unsafe { library.get::<F>(name) };
    symbol
        .map(|symbol| *symbol)
        .with_context(|| format!("the library has no function {name}; it is too old or another one"))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Compiles a stand-in for a maker's library; each test its own, so that their statics are their own.
    pub(crate) fn compiled(source: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let (code, library) = (folder.path().join("fake.c"), folder.path().join("libfake.so"));
        std::fs::write(&code, source).unwrap();
        let output = std::process::Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .arg(&library)
            .arg(&code)
            .output()
            .expect("tests of drivers need a C compiler, cc");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        (folder, library)
    }

    const NOWHERE: VendorLibrary = VendorLibrary {
        name: "a maker",
        variable: "GLISSON_TEST_LIBRARY_THAT_NOBODY_SETS",
        file_names: &["libglisson-nowhere.so.1", "libglisson-nowhere.so"],
        source: "the maker",
    };

    #[test]
    fn a_missing_library_is_told_with_what_was_tried_and_a_remedy() {
        let error = NOWHERE.load(None).unwrap_err().to_string();
        for part in ["a maker", "libglisson-nowhere.so.1", NOWHERE.variable, "get it from the maker"] {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn a_library_without_the_function_is_another_one() {
        let (_folder, path) = compiled("int something(void) { return 1; }");
        let (library, _) = NOWHERE.load(Some(&path)).unwrap();
        #[allow(unsafe_code, reason = "the test's own library")]
        // SAFETY: the type of the function that is not there does not matter; the other is the source's.
        let (missing, found) = unsafe {
            let missing = function::<extern "C" fn() -> std::ffi::c_int>(&library, "another");
            (missing, function::<extern "C" fn() -> std::ffi::c_int>(&library, "something"))
        };
        assert!(missing.unwrap_err().to_string().contains("no function another"));
        assert_eq!(found.unwrap()(), 1);
    }
}
