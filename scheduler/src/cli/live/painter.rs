//! Draws frames below the printed lines of a terminal. It draws only changes, and moves the cursor relative to the frame's first line.
//! Even if other programs write to the terminal, or if the terminal is resized, removing the frame erases only the frame.

use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};

use super::terminal;
use crate::cli::console;
use crate::cli::outlet::Display;

/// Minimum width of the display in columns. Narrower terminals show only lines.
pub(super) const COLUMNS_MIN: u16 = 60;

/// Escape sequence that erases the cursor's line and everything below, and keeps the cursor in that line. It first erases the line, and
/// then the rest from the second column: if a screen is erased from its very first cell, tmux keeps the erased screen in the scrollback.
const ERASE: &str = "\r\x1b[K\x1b[C\x1b[J\r";

/// Whether frames are drawn in colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cli) enum Colours {
    On,
    Off,
}

impl Colours {
    /// Returns the colours of standard error, to which frames are written.
    pub(in crate::cli) fn of_stderr() -> Self {
        if console::stderr_has_colour() { Self::On } else { Self::Off }
    }
}

/// Draws the contents of a frame for a terminal with this many columns and rows. The frame may have fewer rows.
pub(in crate::cli) type Picture = Box<dyn Fn(u16, u16) -> Buffer + Send>;

pub(in crate::cli) struct Painter {
    picture: Picture,
    colours: Colours,
    /// The frame on the screen; the cursor is at its first cell. `None` if no frame is on the screen.
    before: Option<Buffer>,
}

impl Painter {
    pub(in crate::cli) const fn new(picture: Picture, colours: Colours) -> Self {
        Self { picture, colours, before: None }
    }
}

impl Display for Painter {
    fn lift(&mut self) -> Vec<u8> {
        match self.before.take() {
            Some(_) => format!("{ERASE}\x1b[?25h").into_bytes(),
            None => Vec::new(),
        }
    }

    fn draw(&mut self) -> Vec<u8> {
        let Some((columns, rows)) = terminal::size().filter(|(columns, _)| *columns >= COLUMNS_MIN) else {
            return self.lift();
        };
        // The last column stays free, because some terminals move the cursor to the next line after it.
        let next = (self.picture)(columns - 1, rows);
        self.paint(next)
    }
}

impl Painter {
    fn paint(&mut self, next: Buffer) -> Vec<u8> {
        let area = next.area;
        let mut bytes = String::new();
        let before = match self.before.take() {
            Some(before) if before.area == area => before,
            _ => {
                bytes.push_str(ERASE);
                bytes.push_str("\x1b[?25l");
                make_room(&mut bytes, area.height);
                Buffer::empty(area)
            }
        };
        let changes = before.diff(&next);
        write_changes(&mut bytes, &changes, self.colours);
        self.before = Some(next);
        bytes.into_bytes()
    }
}

/// Appends the bytes that scroll until `height` lines are free and move the cursor to the first of these lines.
fn make_room(bytes: &mut String, height: u16) {
    for _ in 1..height {
        bytes.push('\n');
    }
    up(bytes, height - 1);
}

fn up(bytes: &mut String, lines: u16) {
    if lines > 0 {
        bytes.push_str(&format!("\x1b[{lines}A"));
    }
}

fn write_changes(bytes: &mut String, changes: &[(u16, u16, &Cell)], colours: Colours) {
    let (mut line, mut style) = (0, String::new());
    // The cursor's column after the last written cell. `None` if it is unknown.
    let mut column = None;
    for (x, y, cell) in changes {
        if *y > line {
            bytes.push_str(&format!("\x1b[{}B", y - line));
            (line, column) = (*y, None);
        }
        if column != Some(*x) {
            bytes.push_str(&format!("\x1b[{}G", x + 1));
        }
        let wanted = if colours == Colours::On { sequence(cell) } else { String::new() };
        if wanted != style {
            bytes.push_str("\x1b[0m");
            bytes.push_str(&wanted);
            style = wanted;
        }
        bytes.push_str(cell.symbol());
        // A wide character may be drawn narrower than expected, so the cursor is moved to the next cell's column explicitly.
        column = cell.symbol().is_ascii().then_some(x + 1);
    }
    if !style.is_empty() {
        bytes.push_str("\x1b[0m");
    }
    if !changes.is_empty() {
        bytes.push('\r');
        up(bytes, line);
    }
}

/// Returns the escape sequence that begins a cell's style. Empty for a cell without style.
fn sequence(cell: &Cell) -> String {
    let colour = match cell.fg {
        Color::Red => Some("31"),
        Color::Green => Some("32"),
        Color::Yellow => Some("33"),
        Color::Cyan => Some("36"),
        _ => None,
    };
    let bold = cell.modifier.contains(Modifier::BOLD).then_some("1");
    let dim = cell.modifier.contains(Modifier::DIM).then_some("2");
    let codes: Vec<&str> = [bold, dim, colour].into_iter().flatten().collect();
    if codes.is_empty() { String::new() } else { format!("\x1b[{}m", codes.join(";")) }
}

#[cfg(test)]
mod tests {
    use ratatui::layout::Rect;

    use super::*;

    /// Draws frames, with lines between them, on a cleared terminal.
    fn on_a_clear_screen(frames: u16) -> vt100::Parser {
        let mut parser = vt100::Parser::new(24.try_into().unwrap(), 80.try_into().unwrap(), 100);
        let mut write = |bytes: &[u8]| {
            let text = String::from_utf8(bytes.to_vec()).unwrap();
            let mut pieces = text.split("\x1b[J");
            parser.process(pieces.next().unwrap().as_bytes());
            for piece in pieces {
                // tmux would keep the erased screen.
                assert_ne!(parser.screen().cursor_position(), (0, 0), "{text:?}");
                parser.process(b"\x1b[J");
                parser.process(piece.as_bytes());
            }
        };
        write(b"\x1b[H\x1b[2J");
        for number in 0..frames {
            let text = format!("frame {number}");
            write(erased_and(&text).as_bytes());
        }
        write(ERASE.as_bytes());
        write(b"the report\r\n");
        parser
    }

    fn erased_and(text: &str) -> String {
        let area = Rect::new(0, 0, 79, 3);
        let mut next = Buffer::empty(area);
        (0..3).for_each(|y| next.set_string(0, y, text, ratatui::style::Style::new()));
        let mut bytes = ERASE.to_owned();
        // A terminal converts a program's line feeds in this manner.
        make_room(&mut bytes, 3);
        write_changes(&mut bytes, &Buffer::empty(area).diff(&next), Colours::Off);
        bytes.replace('\n', "\r\n")
    }

    #[test]
    fn frames_are_erased_completely_but_never_from_the_first_cell() {
        for frames in [1, 2, 5] {
            let parser = on_a_clear_screen(frames);
            assert_eq!(parser.screen().contents(), "the report");
        }
    }
}
