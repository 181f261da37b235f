//! The program `downbeat`.

/// Messages are made by one thread and dropped by another, for which the system's allocator takes locks: `benches/fan_out.rs`.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    downbeat::main()
}
