//! The program `glisson`. Each verb is a file in `commands/`.
//!
//! Exit codes: 0 done, 1 the work failed (bad input, a check that does not hold), 2 the command line is wrong.
#![allow(clippy::print_stdout, reason = "a command-line program answers on standard output")]

mod bench;
mod commands;
mod demo;
mod picture;
mod plot;
mod runtime;
mod server;
mod validate;

use clap::Parser;

fn main() -> std::process::ExitCode {
    let command_line = commands::CommandLine::parse();
    match commands::run(&command_line) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            std::process::ExitCode::from(1)
        }
    }
}
