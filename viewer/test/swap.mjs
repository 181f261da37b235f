// The keyframes of scripts/examples/swap.yaml: six drones that swap places.
import { readFile } from "node:fs/promises";

export async function readSwap() {
  const text = await readFile(new URL("../../scripts/examples/swap.yaml", import.meta.url), "utf8");
  const cues = [];
  let track = null;
  text.split("\n").forEach((line, i) => {
    const cue = /^  - cue: (.*)/.exec(line);
    const robot = /^    robots: (.*)/.exec(line);
    const device = /^      (\w+):$/.exec(line);
    const step = /at: ([\d.]+)ms, to: ([-\d.]+)/.exec(line);
    const current = cues[cues.length - 1];
    if (cue) cues.push({ name: cue[1], robot: "", first_line: i + 1, last_line: i + 1, tracks: {} });
    else if (robot) current.robot = robot[1];
    else if (device) track = current.tracks[device[1]] = { t: [], v: [] };
    else if (step) {
      track.t.push(Number(step[1]));
      track.v.push(Number(step[2]));
      current.last_line = i + 1;
    }
  });
  return { text, cues };
}
