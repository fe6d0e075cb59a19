//! The program `glisson`, for `main` and for who runs it from another program. Each verb is a file in `commands/`.
#![allow(clippy::print_stdout, reason = "a command-line program answers on standard output")]

mod text_file;
mod demo;
mod commands;

use clap::Parser;
use std::ffi::OsString;
use std::path::Path;

/// Does what a command line asks for (its first word is the program's name), tells on the standard streams what came of it, and answers
/// with the exit code: 0 done, 1 the work failed (bad input, a check that does not hold), 2 the command line is wrong, 3 the simulation
/// broke by a fault of the program; its session is kept.
pub fn run_program<T: Into<OsString> + Clone>(words: impl IntoIterator<Item = T>) -> u8 {
    let command_line = match commands::CommandLine::try_parse_from(words) {
        Ok(command_line) => command_line,
        Err(error) => {
            // Where nobody reads it there is nobody to tell.
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    match commands::run(&command_line) {
        Ok(()) => 0,
        Err(error) => {
            eprintln!("error: {error:#}");
            let is_broken = error.downcast_ref::<glisson_runtime::Broken>().is_some();
            if is_broken { 3 } else { 1 }
        }
    }
}

/// A recorded session as a page that plays it, with the scene's files in `folder`: what `glisson export SESSION --html` writes.
///
/// # Errors
/// A session that cannot be read, or whose replay does not make the bits of the recording; a program that was built without its pages.
pub fn replay_page(session: &Path, folder: &Path) -> anyhow::Result<String> {
    commands::export::page_of(session, folder)
}

/// Ends the process quietly when whoever reads its output stops reading (`glisson check ... | head`): printing then panics.
pub fn leave_closed_pipes_quietly() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let message = panic.payload().downcast_ref::<String>().map_or("", String::as_str);
        if message.contains("failed printing to stdout") && message.contains("Broken pipe") {
            std::process::exit(0);
        }
        tell(panic);
    }));
}
