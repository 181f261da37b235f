// The curves as text: the value of each chosen lane at the playhead.
import type { Observed, Show } from "../data/show";
import type { Track } from "../data/track";
import { useCell } from "../state/cell";
import { useSession } from "../state/session";
import { digits } from "../text/digits";
import { Name } from "../text/Name";
import { describeReading, stepOf, valueOf } from "../text/reading";
import { clock } from "../text/time";

export function Values() {
  const session = useSession();
  const at = useCell(session.playhead);
  const chosen = useCell(session.chosen);
  useCell(session.focusedRow);
  const focused = session.focusedTrack;
  const tracks = focused === null || chosen.includes(focused) ? chosen : [focused, ...chosen];
  if (tracks.length === 0) return <p>Choose lanes in the timeline to see their values here.</p>;
  return (
    <table id="values">
      <caption>At {clock(at)}</caption>
      <thead>
        <tr>
          <th>device</th>
          <th class="number">planned</th>
          <th>step</th>
          <th class="number">last set</th>
          <th class="number">last read</th>
          <th>cue</th>
        </tr>
      </thead>
      <tbody>
        {tracks.map((track) => (
          <ValuesOf key={track.index} show={session.show} track={track} at={at} />
        ))}
      </tbody>
    </table>
  );
}

function ValuesOf({ show, track, at }: { show: Show; track: Track; at: number }) {
  const reading = track.at(at);
  const cue = show.cueAt(track.robotIndex, at);
  const observed = (kind: "set" | "read") => digits(latest(show.observed(kind, track), at));
  return (
    <tr>
      <th scope="row">
        <Name text={`${track.robot.id} / ${track.name}`} />
      </th>
      <td class="number" title={describeReading(track, reading)}>
        <Name text={valueOf(track, reading)} />
        {NOTES[reading.known]}
      </td>
      <td>{stepOf(track, reading).replace("step ", "")}</td>
      <td class="number">{observed("set")}</td>
      <td class="number">{observed("read")}</td>
      <td>{cue !== null && <Name text={cue.cue.name} />}</td>
    </tr>
  );
}

const NOTES = { moving: "", held: " (held)", unplayed: " (not played)", default: " (default)", first: " (not known)", unknown: "not known" };

function latest(observed: Observed[], at: number): number | null {
  let found: { time: number; value: number } | null = null;
  for (const { wave } of observed) {
    const i = wave.at(at);
    if (i >= 0 && (found === null || wave.time(i) >= found.time)) found = { time: wave.time(i), value: wave.value(i) };
  }
  return found === null ? null : found.value;
}
