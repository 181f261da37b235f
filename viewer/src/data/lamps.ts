// Lights: which devices of a robot are its colours, its dimmer, its pan and its tilt, and how they shine at a time.
import type { Robot } from "../mission";
import type { Show } from "./show";
import type { Track } from "./track";

/** Red, green and blue from 0 to 1, with the dimmer. */
export type Colour = readonly [number, number, number];

/** A light. `pan` and `tilt` are in radians; `null` if the light has no direction. */
export interface Light {
  robot: number;
  colour: Colour;
  beam: { pan: number; tilt: number } | null;
}

/** A device, and which of its values. */
type Channel = Track;

interface Fixture {
  robot: number;
  /** Red, green and blue; white and amber are added. `null`: white light. */
  colours: { track: Channel; mix: Colour }[] | null;
  dimmer: Channel | null;
  pan: Channel | null;
  tilt: Channel | null;
}

const fixtures = new WeakMap<Show, readonly Fixture[]>();

export function fixturesOf(show: Show): readonly Fixture[] {
  let found = fixtures.get(show);
  if (found === undefined) {
    found = show.mission.robots.flatMap((robot, index) => fixtureOf(show, robot, index) ?? []);
    fixtures.set(show, found);
  }
  return found;
}

const COLOURED = /\b(lamps?|lights?|leds?|rgbw?|colou?rs?)\b/i;
const MIXES: [RegExp, Colour][] = [
  [/\bred\b/i, [1, 0, 0]],
  [/\bgreen\b/i, [0, 1, 0]],
  [/\bblue\b/i, [0, 0, 1]],
  [/\b(warm.?)?white\b/i, [1, 1, 1]],
  [/\bamber\b/i, [1, 0.6, 0]],
];
const DIMMER = /\b(dimmer|intensity|brightness)\b/i;
const PAN = /\bpan\b/i;
const TILT = /\btilt\b/i;

function fixtureOf(show: Show, { devices }: Robot, robot: number): Fixture | null {
  const words = devices.map(({ id, name }) => `${id} ${name ?? ""}`.replace(/[_-]/g, " "));
  const tracks = (device: number) => show.tracksOf[robot].filter(({ deviceIndex }) => deviceIndex === device);
  const first = (pattern: RegExp) => {
    const device = words.findIndex((text) => pattern.test(text) && !/\bfine\b/i.test(text));
    return device < 0 ? null : (tracks(device)[0] ?? null);
  };
  const several = devices.findIndex((_, device) => COLOURED.test(words[device]) && tracks(device).length >= 3);
  const single = MIXES.flatMap(([pattern, mix]) => {
    const track = first(pattern);
    return track === null ? [] : [{ track, mix }];
  });
  const colours =
    several >= 0
      ? tracks(several)
          .slice(0, 4)
          .map((track, i) => ({ track, mix: MIXES[i][1] }))
      : single.length >= 2
        ? single
        : null;
  const dimmer = first(DIMMER);
  if (colours === null && dimmer === null) return null;
  return { robot, colours, dimmer, pan: first(PAN), tilt: first(TILT) };
}

/** The robots that have a light, lit or not. */
export function litRobots(show: Show): ReadonlySet<number> {
  return new Set(fixturesOf(show).map(({ robot }) => robot));
}

export function lightsAt(show: Show, ms: number): Light[] {
  return fixturesOf(show).map(({ robot, colours, dimmer, pan, tilt }) => {
    const level = dimmer === null ? 1 : shareOf(dimmer, ms);
    const sum = [0, 0, 0];
    for (const { track, mix } of colours ?? []) {
      const share = shareOf(track, ms);
      mix.forEach((part, i) => (sum[i] += part * share));
    }
    const [red, green, blue] = colours === null ? [1, 1, 1] : sum.map((part) => Math.min(1, part));
    const beam = pan === null && tilt === null ? null : { pan: angleOf(pan, ms), tilt: angleOf(tilt, ms) };
    return { robot, colour: [red * level, green * level, blue * level], beam };
  });
}

/** Value from 0 to 1 within the range of the device: bytes by default. A lamp is dark until its first value. */
function shareOf(track: Track, ms: number): number {
  const value = track.lastSet(ms);
  if (value === null) return 0;
  const low = track.device.min ?? 0;
  const high = track.device.max ?? (Math.max(Math.abs(track.extent.high), 1) <= 1 ? 1 : 255);
  return high > low ? Math.min(1, Math.max(0, (value - low) / (high - low))) : 0;
}

function angleOf(track: Track | null, ms: number): number {
  const value = track?.lastSet(ms) ?? 0;
  return track !== null && /rad/.test(track.device.unit) ? value : (value * Math.PI) / 180;
}
