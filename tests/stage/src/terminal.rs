//! A pseudoterminal for a process under test. A test reads its output or leaves it unread, and types keys.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};

/// A pseudoterminal: the end of the process under test, and the end of the test.
pub struct Terminal {
    ours: OwnedFd,
    theirs: File,
    size: (u16, u16),
}

impl Terminal {
    /// Creates a terminal of this size.
    pub fn new(columns: u16, rows: u16) -> Self {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&ours).unwrap();
        unlockpt(&ours).unwrap();
        let name = ptsname(&ours, Vec::new()).unwrap().into_string().unwrap();
        let theirs = rustix::fs::open(
            name,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            rustix::fs::Mode::empty(),
        );
        let theirs = File::from(theirs.unwrap());
        tcsetwinsize(&theirs, Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        Self { ours, theirs, size: (columns, rows) }
    }

    /// Fills the terminal until it accepts no further output, as after Ctrl-S.
    pub fn stall(self) -> Self {
        fill(&self.theirs);
        self
    }

    pub fn end(&self) -> Stdio {
        Stdio::from(self.theirs.try_clone().unwrap())
    }

    /// Returns the terminal's mode settings, which a program must restore.
    pub fn settings(&self) -> String {
        let settings = rustix::termios::tcgetattr(&self.theirs).unwrap();
        format!("{:?} {:?} {:?}", settings.input_modes, settings.output_modes, settings.local_modes)
    }

    /// Makes the terminal the input and output of a command. The command runs in its own session, as under a terminal's shell.
    pub fn attach(&self, command: &mut Command) {
        command.stdin(self.end()).stdout(self.end()).stderr(self.end());
        command.env("TERM", "xterm-256color").env_remove("NO_COLOR");
    }

    pub fn type_keys(&self, keys: &str) {
        rustix::io::write(&self.ours, keys.as_bytes()).unwrap();
    }

    /// Waits until all earlier output has been read.
    #[track_caller]
    pub fn settle(&self, watched: &Watched) {
        const MARK: &str = "(nothing more was written)";
        let marks = || watched.raw().matches(MARK).count();
        let before = marks();
        writeln!(&self.theirs, "{MARK}").unwrap();
        crate::quiet::await_that(MARK, || marks() > before);
    }

    /// Starts to read the terminal's output.
    pub fn watch(&self) -> Watched {
        let mut reader = File::from(self.ours.try_clone().unwrap());
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let taken = Arc::clone(&bytes);
        std::thread::spawn(move || {
            let mut buffer = [0; 4_096];
            while let Ok(read @ 1..) = reader.read(&mut buffer) {
                taken.lock().unwrap().extend_from_slice(&buffer[..read]);
            }
        });
        Watched { bytes, size: self.size }
    }
}

/// Writes to a pipe or a terminal until it accepts no further bytes.
pub fn fill(file: &File) {
    let flags = fcntl_getfl(file).unwrap();
    fcntl_setfl(file, flags | OFlags::NONBLOCK).unwrap();
    let mut writer = file;
    while writer.write(&[b'x'; 512]).is_ok() {}
    while writer.write(b"x").is_ok() {}
    fcntl_setfl(file, flags).unwrap();
}

/// The output that was read from a terminal.
pub struct Watched {
    bytes: Arc<Mutex<Vec<u8>>>,
    size: (u16, u16),
}

impl Watched {
    pub fn raw(&self) -> String {
        String::from_utf8_lossy(&self.bytes.lock().unwrap()).into_owned()
    }

    /// Returns the text that a person sees on the terminal, including lines that have scrolled away.
    pub fn screen(&self) -> String {
        let (columns, _) = self.size;
        // The parser's screen is so tall that nothing scrolls away.
        let mut parser = vt100::Parser::new(2_000.try_into().unwrap(), columns.try_into().unwrap(), 0);
        parser.process(&self.bytes.lock().unwrap());
        let text = parser.screen().contents();
        text.lines().map(str::trim_end).collect::<Vec<_>>().join("\n")
    }

    /// Waits until `text` appears on the screen, and returns the screen.
    #[track_caller]
    pub fn shows(&self, text: &str, within: Duration) -> String {
        let began = Instant::now();
        loop {
            let screen = self.screen();
            if screen.contains(text) {
                return screen;
            }
            assert!(began.elapsed() < within, "`{text}` does not come:\n{screen}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
