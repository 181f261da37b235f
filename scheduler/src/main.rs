//! The program `downbeat`.

/// The global allocator. One thread allocates messages and another frees them, for which the system allocator takes locks; see
/// `benches/fan_out.rs`.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    downbeat::main()
}
