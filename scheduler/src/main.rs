//! The program `downbeat`.

fn main() -> std::process::ExitCode {
    downbeat::main()
}
