//! The output of a running mission. On a terminal, a live display is below the printed lines. Elsewhere, there are only lines; with JSON
//! output, there is no progress output.
//!
//! The mission's events change a model. The output thread draws the model ten times a second ([`super::outlet`]). The mission itself
//! never draws and never waits for a terminal. `docs/display.md` shows examples.

mod frame;
mod keys;
mod lines;
mod model;
mod painter;
mod terminal;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex, PoisonError};

use downbeat_scripts::Choreography;
use urrcp::{RobotId, Server, Timestamp};

use self::frame::{Frame, Help};
pub(super) use self::keys::Speaker;
use self::model::Model;
use self::painter::{Colours, Painter};
use super::{Format, console};
use crate::mission::Progress;
use crate::server_clock::ServerClock;
use crate::show::{Detail, PreflightDetails, UNBOUNDED, preflight_table, preflight_warnings};

/// The data that the output thread draws.
struct Scene {
    model: Model,
    help: Help,
    clock: ServerClock,
    shown: Shown,
}

/// Whether the display is currently on the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    Yes,
    No,
}

impl Scene {
    fn frame(&self, columns: u16, rows: u16) -> Frame {
        Frame::of(&self.model, self.clock.now(), self.help, columns, rows)
    }
}

/// The output of one mission while it runs. The terminal is restored on drop.
pub(super) struct Live {
    format: Format,
    /// The data of the display. `None` if only lines are printed.
    scene: Option<Arc<Mutex<Scene>>>,
}

impl Live {
    /// Creates an output that prints only lines.
    pub(super) const fn lines(format: Format) -> Self {
        Self { format, scene: None }
    }

    /// Starts the display, if the terminal supports it, and handles the operator's keys. Must be called within a Tokio runtime.
    pub(super) fn start(
        format: Format,
        clock: ServerClock,
        choreography: Arc<Choreography>,
        robots: impl IntoIterator<Item = RobotId>,
        speaker: Speaker,
    ) -> Self {
        if format == Format::Json || !terminal::can_draw() {
            keys::listen_to_lines(speaker);
            return Self::lines(format);
        }
        let model = Model::new(choreography, robots, clock.now());
        let scene = Arc::new(Mutex::new(Scene { model, help: Help::Hidden, clock, shown: Shown::Yes }));
        keys::listen(Arc::clone(&scene), speaker);
        keys::watch_suspension(Arc::clone(&scene));
        show(&scene);
        Self { format, scene: Some(scene) }
    }

    pub(super) fn tell(&self, at: Timestamp<Server>, progress: &Progress) {
        if let Some(scene) = &self.scene {
            scene.lock().unwrap_or_else(PoisonError::into_inner).model.tell(at, progress);
        }
        if self.format == Format::Json {
            return;
        }
        if let Some(sentence) = lines::sentence(at, progress, console::detail()) {
            console::note(&sentence);
        }
        let Some(preflight) = lines::table_worth_showing(progress) else { return };
        if console::detail() == Detail::Full {
            let columns = terminal::size().map_or(UNBOUNDED, |(columns, _)| usize::from(columns));
            console::note_block(&preflight_table(preflight, PreflightDetails::Hidden, columns));
        } else {
            preflight_warnings(preflight).iter().for_each(|warning| console::note(warning));
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        if let Some(scene) = &self.scene {
            scene.lock().unwrap_or_else(PoisonError::into_inner).shown = Shown::No;
            console::end_display();
            terminal::restore();
        }
    }
}

fn show(scene: &Arc<Mutex<Scene>>) {
    let colours = if console::stderr_has_colour() { Colours::On } else { Colours::Off };
    console::begin_display(Box::new(Painter::new(Arc::clone(scene), colours)));
}
