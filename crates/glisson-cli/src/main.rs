//! The program `glisson`. Each verb is a file in `commands/`.
//!
//! Exit codes: 0 done, 1 the work failed (bad input, a check that does not hold), 2 the command line is wrong, 3 the
//! simulation broke by a fault of the program; its session is kept.
#![allow(clippy::print_stdout, reason = "a command-line program answers on standard output")]

mod text_file;
mod demo;
mod commands;

use clap::Parser;

/// Ends quietly when whoever reads our output stops reading (`glisson check ... | head`): printing then panics.
fn leave_closed_pipes_quietly() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let message = panic.payload().downcast_ref::<String>().map_or("", String::as_str);
        if message.contains("failed printing to stdout") && message.contains("Broken pipe") {
            std::process::exit(0);
        }
        tell(panic);
    }));
}

fn main() -> std::process::ExitCode {
    leave_closed_pipes_quietly();
    let command_line = commands::CommandLine::parse();
    match commands::run(&command_line) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            let is_broken = error.downcast_ref::<glisson_runtime::Broken>().is_some();
            std::process::ExitCode::from(if is_broken { 3 } else { 1 })
        }
    }
}
