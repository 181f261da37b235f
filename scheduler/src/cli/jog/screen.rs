//! The screen with a slider for each device. Keys change the model, the model is drawn by the output thread, and this module moves the
//! robot.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use downbeat_scripts::FleetRobot;
use downbeat_scripts::shown::shown;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;

use super::hand::{JogError, Movement};
use super::keys::{Key, keys_of};
use super::sliders::{Slider, pose};
use super::{Reserved, SaveAs, TICK, how_to_play};
use crate::cli::live::{Colours, Painter, terminal};
use crate::cli::{Exit, console};

/// Width of the bar of a slider, in columns.
const BAR: usize = 24;
/// Share of the range by which an arrow key moves a device.
const STEP: f64 = 0.01;
/// Share of the range by which the keys `<` and `>` move a device.
const LARGE_STEP: f64 = 0.1;
const KEYS: &str =
    "arrows: choose, move 1 %   < >: 10 %   - digits Enter: position   s: save   space: stop   q: leave";

/// The text that the operator is typing.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Entry {
    /// The position of the selected device.
    Position(String),
    /// The name of a pose.
    Name(String),
}

/// What the operator asks for, beyond changes of targets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Stop,
    Save(String),
    Leave,
}

/// The contents of the screen.
#[derive(Debug)]
pub(super) struct Screen {
    robot: String,
    pub(super) sliders: Vec<Slider>,
    selected: usize,
    entry: Option<Entry>,
    pub(super) message: String,
}

impl Screen {
    pub(super) const fn new(robot: String, sliders: Vec<Slider>) -> Self {
        Self { robot, sliders, selected: 0, entry: None, message: String::new() }
    }

    /// Takes a key, and returns the order that it gives, if any.
    pub(super) fn press(&mut self, key: Key) -> Option<Order> {
        match self.entry.take() {
            Some(entry) => self.edit(entry, key),
            None => self.choose(key),
        }
    }

    fn choose(&mut self, key: Key) -> Option<Order> {
        let last = self.sliders.len().saturating_sub(1);
        match key {
            Key::Up => self.selected = self.selected.saturating_sub(1),
            Key::Down => self.selected = (self.selected + 1).min(last),
            Key::Left => self.nudge(-STEP),
            Key::Right => self.nudge(STEP),
            Key::Char('<' | ',') => self.nudge(-LARGE_STEP),
            Key::Char('>' | '.') => self.nudge(LARGE_STEP),
            Key::Char(c) if c.is_ascii_digit() || c == '-' => {
                self.entry = Some(Entry::Position(c.to_string()))
            }
            Key::Char('s') => self.entry = Some(Entry::Name(String::new())),
            Key::Char(' ') => return Some(Order::Stop),
            Key::Char('q') => return Some(Order::Leave),
            _ => {}
        }
        None
    }

    fn nudge(&mut self, share: f64) {
        let Some(slider) = self.sliders.get_mut(self.selected) else { return };
        slider.nudge(share);
        self.message = match slider.target {
            Some(_) => String::new(),
            None => format!("the position of `{}` is unknown", shown(slider.device.as_str())),
        };
    }

    fn edit(&mut self, mut entry: Entry, key: Key) -> Option<Order> {
        let (Entry::Position(text) | Entry::Name(text)) = &mut entry;
        match key {
            Key::Escape => return None,
            Key::Enter => return self.enter(entry),
            Key::Backspace => drop(text.pop()),
            Key::Char(c) => text.push(c),
            _ => {}
        }
        self.entry = Some(entry);
        None
    }

    fn enter(&mut self, entry: Entry) -> Option<Order> {
        let text = match entry {
            Entry::Name(name) => return Some(Order::Save(name.trim().to_owned())),
            Entry::Position(text) => text,
        };
        let slider = self.sliders.get_mut(self.selected)?;
        let to = text.trim().parse::<f64>().ok().filter(|to| to.is_finite());
        let refused = to.map_or_else(|| Some("expected a number".to_owned()), |to| slider.refuses(to));
        if refused.is_none() {
            slider.target = to;
        }
        self.message = refused.map(|reason| format!("`{}`: {reason}", shown(&text))).unwrap_or_default();
        None
    }

    /// Gives up all movements that have not begun.
    fn forget_targets(&mut self) {
        self.sliders.iter_mut().for_each(|slider| slider.target = None);
    }

    pub(super) fn picture(&self, columns: u16, rows: u16) -> Buffer {
        let bold = Style::new().add_modifier(Modifier::BOLD);
        let dim = Style::new().add_modifier(Modifier::DIM);
        let room = usize::from(rows.saturating_sub(5)).max(1);
        // The selected device stays visible on a small terminal.
        let first = (self.selected + 1).saturating_sub(room);
        let name =
            self.sliders.iter().map(|slider| Line::from(slider.device.as_str()).width()).max().unwrap_or(0);
        let name = name.min(usize::from(columns) / 4);
        let mut lines = vec![Line::styled(format!("{}: reserved", self.robot), bold)];
        for (index, slider) in self.sliders.iter().enumerate().skip(first).take(room) {
            let text = slider_line(slider, name, index == self.selected);
            lines.push(if index == self.selected {
                Line::styled(text, Style::new().fg(Color::Cyan))
            } else {
                Line::raw(text)
            });
        }
        lines.push(Line::styled(KEYS, dim));
        lines.push(match &self.entry {
            Some(Entry::Position(text)) => {
                Line::raw(format!("position: {text}_   (Enter: move, Escape: cancel)"))
            }
            Some(Entry::Name(text)) => Line::raw(format!("save as: {text}_   (Enter: save, Escape: cancel)")),
            None => Line::raw(self.message.clone()),
        });
        let height = u16::try_from(lines.len()).unwrap_or(u16::MAX).min(rows.saturating_sub(1)).max(1);
        let mut buffer = Buffer::empty(Rect::new(0, 0, columns, height));
        for (y, line) in (0..height).zip(&lines) {
            buffer.set_line(0, y, line, columns);
        }
        buffer
    }
}

/// Returns a line such as `> elbow [----o-----|---] 12.5 to 20 deg, reads 12.4`.
fn slider_line(slider: &Slider, name: usize, is_selected: bool) -> String {
    let mut bar = vec!['-'; BAR];
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 0 to the width of the bar"
    )]
    let column = |value: f64| (slider.share(value) * (BAR - 1) as f64).round() as usize;
    let target = slider.target.filter(|target| Some(*target) != slider.at);
    for (value, mark) in [(target, '|'), (slider.at, 'o')] {
        if let Some(value) = value {
            bar[column(value)] = mark;
        }
    }
    let unit = slider.unit.as_deref().map(|unit| format!(" {unit}")).unwrap_or_default();
    // During a movement, the commanded position is between those of the grid.
    let at = slider.at.map(|at| slider.limits.nearest_settable(at));
    let at = at.map_or_else(|| "unknown".to_owned(), |at| at.to_string());
    let to = target.map(|target| format!(" to {target}")).unwrap_or_default();
    let reads = slider.reading.map(|reading| format!(", reads {reading}")).unwrap_or_default();
    let mark = if is_selected { '>' } else { ' ' };
    let (device, bar) = (shown(slider.device.as_str()).to_string(), bar.into_iter().collect::<String>());
    format!("{mark} {device:<name$} [{bar}] {at}{to}{unit}{reads}")
}

/// Restores the terminal on drop.
struct OnTerminal;

impl OnTerminal {
    fn begin(screen: &Arc<Mutex<Screen>>) -> Self {
        terminal::take_keys();
        let screen = Arc::clone(screen);
        let picture = move |columns, rows| lock(&screen).picture(columns, rows);
        console::begin_display(Box::new(Painter::new(Box::new(picture), Colours::of_stderr())));
        Self
    }
}

impl Drop for OnTerminal {
    fn drop(&mut self) {
        console::end_display();
        terminal::restore();
    }
}

fn lock(screen: &Mutex<Screen>) -> MutexGuard<'_, Screen> {
    screen.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Lets the operator move the devices, until they leave or the robot is lost.
pub(super) async fn operate(
    reserved: &mut Reserved<'_>,
    robot: &FleetRobot,
    mut sliders: Vec<Slider>,
    poses: &Path,
) -> Result<Exit, JogError> {
    reserved.hand.look(&mut sliders).await?;
    let screen = Arc::new(Mutex::new(Screen::new(shown(robot.id.as_str()).to_string(), sliders)));
    let mut keys = typed();
    // Suspended, the program could neither move the robot nor restore the terminal.
    let suspended: Option<Signal> = signal(SignalKind::from_raw(rustix::process::Signal::TSTP.as_raw())).ok();
    let _on_terminal = OnTerminal::begin(&screen);
    let mut operation = Operation { reserved, screen: &screen, movement: None, poses };
    let ended = operation.until_left(&mut keys).await;
    drop(suspended);
    ended
}

/// Returns the keys that are typed. Another thread reads them, which ends with the process.
fn typed() -> mpsc::UnboundedReceiver<Key> {
    let (send, keys) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        while let Some(bytes) = terminal::next_keys() {
            if keys_of(&bytes).into_iter().any(|key| send.send(key).is_err()) {
                return;
            }
        }
    });
    keys
}

struct Operation<'a, 'b> {
    reserved: &'a mut Reserved<'b>,
    screen: &'a Mutex<Screen>,
    movement: Option<Movement>,
    poses: &'a Path,
}

impl Operation<'_, '_> {
    async fn until_left(&mut self, keys: &mut mpsc::UnboundedReceiver<Key>) -> Result<Exit, JogError> {
        loop {
            tokio::select! {
                _ = self.reserved.signals.next() => return Ok(Exit::Stopped),
                key = keys.recv() => {
                    let Some(key) = key else { return Ok(Exit::Done) };
                    let order = lock(self.screen).press(key);
                    if order == Some(Order::Leave) {
                        return Ok(Exit::Done);
                    }
                    if let Some(order) = order {
                        self.follow(order).await?;
                    }
                }
                () = tokio::time::sleep(TICK) => {}
            }
            if let Err(error) = self.step().await {
                self.movement = None;
                if !error.is_passing() {
                    return Err(error);
                }
                let mut screen = lock(self.screen);
                screen.forget_targets();
                screen.message = error.to_string();
            }
        }
    }

    async fn follow(&mut self, order: Order) -> Result<(), JogError> {
        match order {
            Order::Stop => {
                lock(self.screen).forget_targets();
                self.movement = None;
                self.reserved.hand.hold().await?;
                lock(self.screen).message = "stopped".to_owned();
            }
            Order::Save(name) => {
                // The positions on the screen may be those of the last tick.
                self.look().await?;
                let mut screen = lock(self.screen);
                let pose = pose(&screen.sliders);
                let saved = SaveAs { name, path: self.poses.to_path_buf() };
                screen.message = match saved.write(&pose) {
                    Ok(()) => how_to_play(&saved.name, &saved.path),
                    Err(reason) => reason,
                };
            }
            Order::Leave => {}
        }
        Ok(())
    }

    /// Renews the leases, and reads the positions back.
    async fn look(&mut self) -> Result<Vec<Slider>, JogError> {
        let mut sliders = lock(self.screen).sliders.clone();
        self.reserved.hand.look(&mut sliders).await?;
        for (shown, read) in lock(self.screen).sliders.iter_mut().zip(&sliders) {
            (shown.at, shown.reading) = (read.at, read.reading);
        }
        Ok(sliders)
    }

    /// Begins the next movement once the previous one has ended.
    async fn step(&mut self) -> Result<(), JogError> {
        let sliders = self.look().await?;
        if let Some(movement) = &self.movement
            && !self.reserved.hand.has_ended(movement)?
        {
            return Ok(());
        }
        self.movement = self.reserved.hand.start(&sliders).await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use urrcp::Limits;

    use super::*;

    fn slider(device: &str, at: Option<f64>) -> Slider {
        Slider {
            device: device.parse().unwrap(),
            unit: Some("deg".to_owned()),
            limits: Limits::new(-90.0, 90.0, 0.5).unwrap(),
            moves_linearly: true,
            sensor: None,
            at,
            reading: None,
            target: None,
        }
    }

    fn screen() -> Screen {
        Screen::new("arm".to_owned(), vec![slider("elbow", Some(0.0)), slider("wrist", None)])
    }

    fn type_text(screen: &mut Screen, text: &str) -> Option<Order> {
        text.chars().filter_map(|c| screen.press(if c == '\n' { Key::Enter } else { Key::Char(c) })).last()
    }

    fn text(screen: &Screen, columns: u16, rows: u16) -> String {
        let buffer = screen.picture(columns, rows);
        let line = |y: u16| (0..columns).map(|x| buffer[(x, y)].symbol()).collect::<String>();
        (0..buffer.area.height).map(|y| line(y).trim_end().to_owned()).collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn arrows_move_the_target_on_the_grid_and_within_the_limits() {
        let mut screen = screen();
        screen.press(Key::Right);
        assert_eq!(screen.sliders[0].target, Some(2.0), "1 % of 180 degrees, on the grid");
        screen.press(Key::Left);
        screen.press(Key::Left);
        assert_eq!(screen.sliders[0].target, Some(-2.0));
        (0..20).for_each(|_| drop(screen.press(Key::Char('<'))));
        assert_eq!(screen.sliders[0].target, Some(-90.0));
        screen.press(Key::Down);
        screen.press(Key::Down);
        screen.press(Key::Right);
        assert_eq!(screen.sliders[1].target, None);
        assert_eq!(screen.message, "the position of `wrist` is unknown");
    }

    #[test]
    fn typed_positions_are_checked_and_names_are_orders() {
        let mut screen = screen();
        assert_eq!(type_text(&mut screen, "-12.5\n"), None);
        assert_eq!(screen.sliders[0].target, Some(-12.5));
        for (typed, message) in [
            ("91\n", "`91`: expected -90 to 90"),
            ("1.3\n", "`1.3`: expected a multiple of 0.5, such as 1.5"),
            ("1e\n", "`1e`: expected a number"),
        ] {
            type_text(&mut screen, typed);
            assert_eq!((screen.message.as_str(), screen.sliders[0].target), (message, Some(-12.5)));
        }
        // While a name is typed, `q` and the space are letters of it.
        assert_eq!(type_text(&mut screen, "squick q\n"), Some(Order::Save("quick q".to_owned())));
        assert_eq!(type_text(&mut screen, "5"), None);
        assert_eq!(screen.press(Key::Escape), None);
        assert_eq!(type_text(&mut screen, " "), Some(Order::Stop));
        assert_eq!(type_text(&mut screen, "q"), Some(Order::Leave));
    }

    #[test]
    fn screen_shows_positions_targets_and_readings() {
        let mut screen = screen();
        screen.sliders[0].at = Some(0.1234);
        screen.sliders[0].target = Some(90.0);
        screen.sliders[0].reading = Some(0.25);
        let shown = text(&screen, 100, 24);
        let lines: Vec<_> = shown.lines().collect();
        assert_eq!(lines[0], "arm: reserved");
        assert_eq!(lines[1], "> elbow [------------o----------|] 0 to 90 deg, reads 0.25");
        assert_eq!(lines[2], "  wrist [------------------------] unknown deg");
        // The pose has a position on the grid, and none for a device whose position is unknown.
        let pose: Vec<_> = pose(&screen.sliders).into_iter().map(|device| device.position).collect();
        assert_eq!(pose, [0.0]);
        screen.press(Key::Down);
        let small = text(&screen, 60, 6);
        assert!(small.contains("> wrist") && !small.contains("elbow"), "{small}");
    }
}
