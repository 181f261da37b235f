// Colours that identify robots without a lamp. Robots may share a hue; the label identifies a robot.
import type { Colour } from "../data/lamps";

/** Hues in degrees. */
const HUES = [212, 28, 150, 275, 335, 95, 190, 55];
const [SATURATION, LIGHTNESS] = [0.65, 0.68];

export const hueOf = (robot: number) => HUES[robot % HUES.length];

export function colourOf(robot: number): Colour {
  const part = (shift: number) => {
    const k = (shift + hueOf(robot) / 30) % 12;
    return LIGHTNESS - SATURATION * Math.min(LIGHTNESS, 1 - LIGHTNESS) * Math.max(-1, Math.min(k - 3, 9 - k, 1));
  };
  return [part(0), part(8), part(4)];
}

export function css(colour: Colour, alpha = 1): string {
  const [red, green, blue] = colour.map((part) => Math.round(255 * Math.min(1, part)));
  return `rgba(${red}, ${green}, ${blue}, ${alpha})`;
}
