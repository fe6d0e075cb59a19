//! The program `glisson`.

fn main() -> std::process::ExitCode {
    glisson_cli::leave_closed_pipes_quietly();
    glisson_cli::run_program(std::env::args_os()).into()
}
