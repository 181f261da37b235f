// Deviations of robots from the plan, largest first.
import { useMemo, useState } from "preact/hooks";
import { comparesAll, deviations, KEPT, type Deviation } from "../data/deviations";
import { useCell } from "../state/cell";
import { choose } from "../state/choose";
import { seekAndShow } from "../state/moves";
import { useSession, type Session } from "../state/session";
import { signedTime, significant, time } from "../text/amount";
import { digits, withUnit } from "../text/digits";
import { Name } from "../text/Name";
import { clock } from "../text/time";
import { Limited } from "./Limited";

export function Deviations() {
  const session = useSession();
  const [kind, setKind] = useState<Deviation["kind"] | "all">("all");
  const chosen = useCell(session.chosen);
  const complete = useMemo(() => comparesAll(session.show), [session.show]);
  const tracks = complete ? session.show.tracks : chosen;
  const { listed: all, uncertain } = useMemo(() => deviations(session.show, tracks), [session.show, tracks]);
  if (all.length === 0)
    return (
      <p>
        {uncertain > 0 ? "No deviation is larger than the uncertainty of the clocks." : nothing(session, complete)} {ignored(uncertain)}
      </p>
    );
  return (
    <>
      <label>
        Kind{" "}
        <select value={kind} onChange={(event) => setKind(event.currentTarget.value as Deviation["kind"] | "all")}>
          <option value="all">all deviations</option>
          <option value="start">starts</option>
          <option value="time">times of steps</option>
          <option value="value">values</option>
        </select>
      </label>
      <small>
        {" "}
        the {KEPT} largest of each kind{!complete && ", of the lanes whose curves are shown"}. {ignored(uncertain)}
      </small>
      <Limited items={all.filter((deviation) => kind === "all" || deviation.kind === kind)} name="deviations">
        {(some) => (
          <table id="deviations">
            <thead>
              <tr>
                <th>at</th>
                <th>device</th>
                <th>of</th>
                <th class="number">set minus planned</th>
                <th class="number">clock known to</th>
              </tr>
            </thead>
            <tbody>
              {some.map((deviation, i) => (
                <tr key={i}>
                  <td>
                    <button type="button" class="link" onClick={() => go(session, deviation)}>
                      {clock(deviation.at)}
                    </button>
                  </td>
                  <th scope="row">
                    <Name text={`${deviation.track.robot.id} / ${deviation.track.name}`} />
                  </th>
                  <td>{deviation.kind}</td>
                  <td class="number" title={allDigits(deviation)}>
                    <Name text={amount(deviation)} />
                  </td>
                  <td class="number">{certainty(session, deviation)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        )}
      </Limited>
    </>
  );
}

function nothing({ show }: Session, complete: boolean): string {
  if (show.mission.set.length === 0) return "Nothing tells what the robots set, so nothing can be compared with the plan.";
  return complete
    ? "The robots did what was planned."
    : "The robots of the curves shown did what was planned. Choose other lanes to compare them.";
}

function ignored(uncertain: number): string {
  if (uncertain === 0) return "";
  return `${uncertain} ${uncertain === 1 ? "deviation is" : "deviations are"} smaller than the uncertainty of the clocks and not listed.`;
}

function go(session: Session, { at, track }: Deviation): void {
  seekAndShow(session, at);
  if (!session.chosen.value.includes(track)) choose(session, track);
}

function certainty({ show }: Session, { kind, track, at }: Deviation): string {
  const uncertainty = show.clockUncertainty(track.robotIndex, at);
  return kind === "value" || uncertainty === 0 ? "" : `± ${time(uncertainty)}`;
}

function amount({ kind, by, track }: Deviation): string {
  return kind === "value" ? `${by < 0 ? "" : "+"}${withUnit(significant(by), track.device.unit)}` : signedTime(by);
}

function allDigits({ kind, by, track }: Deviation): string {
  return `exactly ${kind === "value" ? withUnit(digits(by), track.device.unit) : `${digits(by)} ms`}`;
}
