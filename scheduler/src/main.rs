//! The program `downbeat`.

/// One thread creates messages and another drops them. The system allocator takes locks for that: `benches/fan_out.rs`.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    downbeat::main()
}
