//! Plays light programs of Skybrush. Their bytes are commands that set colours, fade, wait and repeat, in frames of 20 ms.

use super::malformed::Malformed;

/// Duration of one frame, in milliseconds.
const FRAME_MS: u64 = 20;
/// Maximum number of executed commands, and maximum number of nested loops.
const COMMANDS_MAX: usize = 200_000;
const LOOPS_MAX: usize = 16;

/// A colour: red, green and blue, each from 0 to 255.
pub(super) type Color = [u8; 3];

/// A change of the lamp's colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Glow {
    pub(super) from_ms: u64,
    /// The end of the fade; equal to `from_ms` for an immediate change.
    pub(super) until_ms: u64,
    pub(super) from: Color,
    pub(super) to: Color,
}

/// The result of playing a light program.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Lights {
    /// The changes of colour, in order.
    pub(super) glows: Vec<Glow>,
    /// The time at which the program ends, in milliseconds.
    pub(super) end_ms: u64,
    /// Number of commands for fireworks, which are ignored.
    pub(super) pyro: usize,
    /// Whether the program contains an endless loop, which would continue beyond the end of the show.
    pub(super) endless: bool,
}

struct Player<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The loops that are being executed: the start of each, and its remaining repetitions; `None` for an endless loop.
    loops: Vec<(usize, Option<u8>)>,
    now_ms: u64,
    color: Color,
    lights: Lights,
}

/// Plays a program to its end, or until `until_ms` if it contains an endless loop. Returns an error if the program is invalid.
pub(super) fn play(bytes: &[u8], until_ms: u64) -> Result<Lights, Malformed> {
    let mut player =
        Player { bytes, at: 0, loops: Vec::new(), now_ms: 0, color: [0; 3], lights: Lights::default() };
    for _ in 0..COMMANDS_MAX {
        if !player.step()? {
            player.lights.end_ms = player.now_ms;
            return Ok(player.lights);
        }
        if player.now_ms > until_ms && player.loops.iter().any(|(_, left)| left.is_none()) {
            player.lights.glows.retain(|glow| glow.from_ms <= until_ms);
            player.lights.endless = true;
            player.lights.end_ms = player.now_ms;
            return Ok(player.lights);
        }
    }
    Err(format!("the light program executes more than {COMMANDS_MAX} commands").into())
}

impl Player<'_> {
    /// Executes one command. Returns `false` at the end of the program.
    fn step(&mut self) -> Result<bool, Malformed> {
        let begin = self.at;
        let Some(command) = self.bytes.get(self.at).copied() else { return Ok(false) };
        self.at += 1;
        match command {
            0 => return Ok(false),
            1 => {}
            2 => self.now_ms += self.duration()?,
            3 => self.now_ms = self.now_ms.max(self.duration()?),
            4..=7 => self.set(command)?,
            8..=11 => self.fade(command - 4)?,
            12 => self.begin_loop()?,
            13 => self.end_loop()?,
            20 | 21 => {
                self.byte()?;
                self.lights.pyro += 1;
            }
            16 | 17 => return Err(unsupported(begin, "takes colours from a remote control")),
            18 | 19 => return Err(unsupported(begin, "jumps")),
            14 => return Err(unsupported(begin, "sets the clock back")),
            other => {
                return Err(format!("unknown command {other} at byte {begin} of the light program").into());
            }
        }
        Ok(true)
    }

    fn set(&mut self, command: u8) -> Result<(), Malformed> {
        let color = self.color_of(command)?;
        let duration = self.duration()?;
        let (from_ms, from) = (self.now_ms, self.color);
        self.lights.glows.push(Glow { from_ms, until_ms: from_ms, from, to: color });
        self.color = color;
        self.now_ms += duration;
        Ok(())
    }

    fn fade(&mut self, command: u8) -> Result<(), Malformed> {
        let color = self.color_of(command)?;
        let from_ms = self.now_ms;
        self.now_ms += self.duration()?;
        self.lights.glows.push(Glow { from_ms, until_ms: self.now_ms, from: self.color, to: color });
        self.color = color;
        Ok(())
    }

    fn color_of(&mut self, command: u8) -> Result<Color, Malformed> {
        Ok(match command {
            4 => [self.byte()?, self.byte()?, self.byte()?],
            5 => [self.byte()?; 3],
            6 => [0; 3],
            _ => [255; 3],
        })
    }

    fn begin_loop(&mut self) -> Result<(), Malformed> {
        let turns = self.byte()?;
        if self.loops.len() == LOOPS_MAX {
            return Err(format!("the light program has more than {LOOPS_MAX} nested loops").into());
        }
        self.loops.push((self.at, (turns > 0).then_some(turns)));
        Ok(())
    }

    fn end_loop(&mut self) -> Result<(), Malformed> {
        let Some((begin, left)) = self.loops.last_mut() else {
            return Err(
                format!("unexpected end of a loop at byte {} of the light program", self.at - 1).into()
            );
        };
        match left {
            Some(1) => drop(self.loops.pop()),
            Some(left) => {
                *left -= 1;
                self.at = *begin;
            }
            None => self.at = *begin,
        }
        Ok(())
    }

    fn byte(&mut self) -> Result<u8, Malformed> {
        let byte = self.bytes.get(self.at).copied();
        self.at += 1;
        byte.ok_or_else(|| "the light program ends within a command".into())
    }

    /// Reads a duration: a number of frames with seven bits per byte, least significant first.
    fn duration(&mut self) -> Result<u64, Malformed> {
        let mut frames = 0_u64;
        for shift in [0, 7, 14, 21] {
            let byte = self.byte()?;
            frames |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(frames * FRAME_MS);
            }
        }
        Err(format!("a time at byte {} of the light program has more than four bytes", self.at - 1).into())
    }
}

fn unsupported(at: usize, what: &str) -> Malformed {
    format!(
        "the light program {what} at byte {at}: commands that depend on the running show are not supported"
    )
    .into()
}

/// Returns the colours, each with its time: at each change and, during a fade, at each multiple of the period. The last colour is at the
/// end of the program.
pub(super) fn sampled(lights: &Lights, period_ms: u64) -> Vec<(u64, Color)> {
    let mut samples: Vec<(u64, Color)> = vec![(0, [0; 3])];
    let mut add = |at_ms: u64, color: Color| match samples.last_mut() {
        Some(last) if last.0 == at_ms => last.1 = color,
        _ => samples.push((at_ms, color)),
    };
    for glow in &lights.glows {
        let length = glow.until_ms - glow.from_ms;
        let mut at_ms = glow.from_ms + period_ms;
        // A fade starts with the current colour.
        while at_ms < glow.until_ms {
            add(at_ms, between(glow, (at_ms - glow.from_ms) as f64 / length as f64));
            at_ms += period_ms;
        }
        add(glow.until_ms, glow.to);
    }
    let last = samples.last().map_or([0; 3], |last| last.1);
    if samples.last().is_some_and(|(at_ms, _)| *at_ms < lights.end_ms) {
        samples.push((lights.end_ms, last));
    }
    samples
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between two bytes")]
fn between(glow: &Glow, share: f64) -> Color {
    let mix = |from: u8, to: u8| (f64::from(from) + (f64::from(to) - f64::from(from)) * share).round() as u8;
    [0, 1, 2].map(|index| mix(glow.from[index], glow.to[index]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_set_faded_and_repeated() {
        // Red for 100 ms; then twice: fade to white in 40 ms, and black for 20 ms; then wait until 1 s; grey.
        let program = [4, 255, 0, 0, 5, 12, 2, 11, 2, 6, 1, 13, 3, 50, 5, 7, 0, 0];
        let lights = play(&program, 60_000).unwrap();
        assert_eq!(lights.end_ms, 1_000);
        let expected = [
            (0, [255, 0, 0]),
            (120, [255, 128, 128]),
            (140, [0; 3]),
            (180, [128; 3]),
            (200, [0; 3]),
            (1_000, [7; 3]),
        ];
        assert_eq!(sampled(&lights, 20), expected);
    }

    #[test]
    fn endless_loops_end_with_the_show_and_runaway_programs_are_refused() {
        let lights = play(&[12, 0, 7, 5, 6, 5, 13], 1_000).unwrap();
        assert!(lights.endless && lights.glows.len() == 11, "{}", lights.glows.len());
        for wrong in
            [&[12, 0, 13][..], &[13], &[4, 1], &[18, 0], &[99], &[2, 255, 255, 255, 255, 1], &[12; 40]]
        {
            assert!(play(wrong, 1_000).is_err(), "{wrong:?}");
        }
        assert_eq!(play(&[], 1_000), Ok(Lights::default()));
    }
}
