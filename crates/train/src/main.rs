//! The `train` program; everything is in the library.

fn main() -> std::process::ExitCode {
    train::cli::main()
}
