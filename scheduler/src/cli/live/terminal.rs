//! Settings of the terminal while the display is shown: keys arrive without Enter and without an echo. The terminal itself handles Ctrl-C
//! and Ctrl-Z, so that these keys work in any state of this process. The settings are restored at every end of the process except
//! SIGKILL.

use std::io::IsTerminal;
use std::sync::{Mutex, Once, PoisonError};

use rustix::event::{PollFd, PollFlags};
use rustix::io::Errno;
use rustix::stdio::stdin;
use rustix::termios::{InputModes, LocalModes, OptionalActions, SpecialCodeIndex, Termios};

use crate::signals::restore_before_death;

/// The terminal's settings before this process changed them. `None` if they are unchanged.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);
static ON_PANIC: Once = Once::new();

/// Returns the columns and rows of the terminal on standard error. `None` if there is no terminal.
pub(super) fn size() -> Option<(u16, u16)> {
    let size = rustix::termios::tcgetwinsize(rustix::stdio::stderr()).ok()?;
    // The default applies to a terminal that does not report its size, for example on a serial line.
    let known = |value, default| if value == 0 { default } else { value };
    Some((known(size.ws_col, 80), known(size.ws_row, 24)))
}

/// Whether a display can be drawn: standard error is a terminal that can overwrite lines.
pub(in crate::cli) fn can_draw() -> bool {
    let dumb = std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb");
    std::io::stderr().is_terminal()
        && !dumb
        && size().is_some_and(|(columns, _)| columns >= super::painter::COLUMNS_MIN)
}

/// Whether this process is in the foreground of its terminal and receives keys. The system suspends a background process that reads from
/// its terminal or changes its settings.
fn is_in_foreground() -> bool {
    rustix::termios::tcgetpgrp(stdin()).is_ok_and(|group| group == rustix::process::getpgrp())
}

/// Whether standard input is a terminal, so that an operator may press keys.
pub(in crate::cli) fn has_keys() -> bool {
    std::io::stdin().is_terminal()
}

/// Switches the terminal to a mode in which each key arrives at once, without Enter and without an echo.
pub(in crate::cli) fn take_keys() {
    if !has_keys() || is_in_background() {
        return;
    }
    let Ok(before) = rustix::termios::tcgetattr(stdin()) else { return };
    let mut settings = before.clone();
    settings.local_modes -= LocalModes::ICANON | LocalModes::ECHO;
    // Ctrl-S would freeze the display.
    settings.input_modes -= InputModes::IXON;
    settings.special_codes[SpecialCodeIndex::VMIN] = 1;
    settings.special_codes[SpecialCodeIndex::VTIME] = 0;
    restore_before_death(restore);
    ON_PANIC.call_once(|| {
        let report = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            restore();
            report(panic);
        }));
    });
    let mut kept = BEFORE.lock().unwrap_or_else(PoisonError::into_inner);
    if rustix::termios::tcsetattr(stdin(), OptionalActions::Now, &settings).is_ok() {
        kept.get_or_insert(before);
    }
}

/// Whether another program is in the foreground of the terminal. Without a controlling terminal, no program is.
fn is_in_background() -> bool {
    rustix::termios::tcgetsid(stdin()).is_ok() && !is_in_foreground()
}

/// Restores the terminal's settings. Has no effect if this process did not change them, or if another program is in the foreground: the
/// settings then belong to that program, and a background process that changes them is suspended.
pub(in crate::cli) fn restore() {
    let before = BEFORE.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(before) = before.filter(|_| !is_in_background()) {
        // The change applies immediately, because a blocked terminal never accepts the pending output.
        let _gone = rustix::termios::tcsetattr(stdin(), OptionalActions::Now, &before);
    }
}

/// Waits for the next keys and returns their bytes. Returns `None` once standard input has ended.
pub(in crate::cli) fn next_keys() -> Option<Vec<u8>> {
    loop {
        let keyboard = stdin();
        let mut ready = [PollFd::new(&keyboard, PollFlags::IN)];
        match rustix::event::poll(&mut ready, None) {
            Err(Errno::INTR) => continue,
            Err(_) => return None,
            Ok(_) => {}
        }
        if is_in_background() {
            // Another program is in the foreground and receives the keys.
            let pause = rustix::event::Timespec { tv_sec: 0, tv_nsec: 200_000_000 };
            let _interrupted = rustix::event::poll(&mut [], Some(&pause));
            continue;
        }
        let mut keys = [0; 64];
        match rustix::io::read(stdin(), &mut keys) {
            Ok(0) => return None,
            Ok(read) => return Some(keys[..read].to_vec()),
            Err(Errno::INTR | Errno::AGAIN) => {}
            Err(_) => return None,
        }
    }
}
