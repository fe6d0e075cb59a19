//! Writing files so that a failure leaves nothing half-written.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// What programs that write the same file at one time do not share. A page has files of its own, and no number.
fn temporary_ending() -> String {
    let process = if cfg!(target_family = "wasm") { 0 } else { std::process::id() };
    format!(".{process}.tmp")
}

/// Writes `path` through a temporary file beside it, renamed into place only after `write` succeeded and
/// the bytes reached the disk. On any error the old file, if there was one, is untouched.
///
/// # Errors
/// Whatever `write` or the file system answers.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidInput, format!("{} names no file", path.display()))
    })?;
    let mut temporary_name = std::ffi::OsString::from(".");
    temporary_name.push(name);
    temporary_name.push(temporary_ending());
    let temporary = path.with_file_name(temporary_name);
    let result = (|| {
        let mut writer = BufWriter::new(File::create(&temporary)?);
        write(&mut writer)?;
        writer.flush()?;
        writer.get_ref().sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    if result.is_err() {
        // The first error is the one to report; a temporary that was never made cannot be removed.
        let _ = std::fs::remove_file(&temporary);
    }
    result
}

/// Fills the folder `path` through a temporary one beside it, renamed into place only after `fill` succeeded. On any
/// error there is no folder that was not there before, nor one above it. The folder may be there already if nothing is in
/// it.
///
/// # Errors
/// A folder that is not empty, a file, or a link in its place ([`io::ErrorKind::AlreadyExists`]); whatever `fill` answers.
pub fn fill_folder_atomically<E: From<io::Error>>(
    path: &Path,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let taken = |what: &str| io::Error::new(io::ErrorKind::AlreadyExists, format!("{what} is there already"));
    // Without dots and slashes at the end; they have no name.
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidInput, format!("{} names no folder", path.display()))
    })?;
    if path.is_symlink() {
        return Err(taken("a link").into());
    }
    let is_there = path.is_dir();
    if is_there && std::fs::read_dir(path)?.next().is_some() {
        return Err(taken("a folder with files in it").into());
    }
    if path.exists() && !is_there {
        return Err(taken("a file").into());
    }
    // From the lowest to the highest.
    let parents = path.ancestors().skip(1).filter(|parent| !parent.as_os_str().is_empty());
    let new_parents: Vec<&Path> = parents.take_while(|parent| !parent.exists()).collect();
    let mut temporary_name = std::ffi::OsString::from(".");
    temporary_name.push(name);
    temporary_name.push(temporary_ending());
    let temporary = path.with_file_name(temporary_name);
    let made = match path.parent() {
        Some(parent) => std::fs::create_dir_all(parent),
        None => Ok(()),
    };
    let result = made.and_then(|()| std::fs::create_dir(&temporary)).map_err(E::from).and_then(|()| {
        let result = fill(&temporary).and_then(|()| {
            if is_there {
                // Refused by the system if something came into it meanwhile.
                std::fs::remove_dir(path)?;
            }
            Ok(std::fs::rename(&temporary, path)?)
        });
        if result.is_err() {
            // The first error is the one to report.
            let _ = std::fs::remove_dir_all(&temporary);
        }
        result
    });
    if result.is_err() {
        // As far as nothing else came into them meanwhile.
        new_parents.iter().for_each(|parent| drop(std::fs::remove_dir(parent)));
    }
    result
}
