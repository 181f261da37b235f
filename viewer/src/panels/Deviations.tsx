// Where robots differ from the plan, the largest first.
import { useMemo, useState } from "preact/hooks";
import { deviations, type Deviation } from "../data/deviations";
import { choose } from "../state/choose";
import { seekAndShow } from "../state/moves";
import { useSession, type Session } from "../state/session";
import { rounded, withUnit } from "../text/digits";
import { Name } from "../text/Name";
import { clock } from "../text/time";
import { Limited } from "./Limited";

export function Deviations() {
  const session = useSession();
  const [kind, setKind] = useState<Deviation["kind"] | "all">("all");
  const all = useMemo(() => deviations(session.show), [session.show]);
  if (all.length === 0) return <p>{session.show.mission.set.length === 0 ? "Nothing tells what the robots set, so nothing can be compared with the plan." : "The robots did what was planned."}</p>;
  return (
    <>
      <label>Kind <select value={kind} onChange={(event) => setKind(event.currentTarget.value as Deviation["kind"] | "all")}>
        <option value="all">all deviations</option>
        <option value="start">starts</option>
        <option value="time">times of steps</option>
        <option value="value">values</option>
      </select></label>
      <Limited items={all.filter((deviation) => kind === "all" || deviation.kind === kind)} name="deviations">
        {(some) => (
          <table id="deviations">
            <thead><tr><th>at</th><th>device</th><th>of</th><th class="number">set minus planned</th></tr></thead>
            <tbody>
              {some.map((deviation, i) => (
                <tr key={i}>
                  <td><button type="button" class="link" onClick={() => go(session, deviation)}>{clock(deviation.at)}</button></td>
                  <th scope="row"><Name text={`${deviation.track.robot.id} / ${deviation.track.device.id}`} /></th>
                  <td>{deviation.kind}</td>
                  <td class="number"><Name text={amount(deviation)} /></td>
                </tr>
              ))}
            </tbody>
          </table>
        )}
      </Limited>
    </>
  );
}

function go(session: Session, { at, track }: Deviation): void {
  seekAndShow(session, at);
  if (!session.chosen.value.includes(track)) choose(session, track);
}

function amount({ kind, by, track }: Deviation): string {
  const sign = by < 0 ? "" : "+";
  return kind === "value" ? `${sign}${withUnit(rounded(by, 6), track.device.unit)}` : `${sign}${rounded(by, 6)} ms`;
}
