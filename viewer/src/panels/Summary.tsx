// The outcome of the mission, with the digits of the report.
import { nameOfAct } from "../data/fate";
import type { Mission, Report, ReportedFailure } from "../mission";
import { useSession } from "../state/session";
import { digits } from "../text/digits";
import { courseText, fateText } from "../text/fate";
import { Name } from "../text/Name";
import { clock, duration } from "../text/time";
import { outcomeText } from "./outcome";

export function Summary() {
  const { mission } = useSession().show;
  const { report } = mission;
  const devices = mission.robots.flatMap((robot) => robot.devices).length;
  const bodies = mission.robots.filter(({ body }) => body !== null).length;
  return (
    <>
      <dl class="facts">
        <dt>scenario</dt>
        <dd>
          <Name text={mission.scenario} />
        </dd>
        <dt>begins</dt>
        <dd>
          <Name text={mission.epoch} />
        </dd>
        <dt>known</dt>
        <dd>
          {clock(mission.from)} to {clock(mission.to)} ({duration(mission.to - mission.from)})
        </dd>
        <dt>robots</dt>
        <dd>
          {mission.robots.length}, {bodies} with a body, {devices} devices
        </dd>
        {report !== null && <Outcome report={report} />}
        <dt>written by</dt>
        <dd>
          <Name text={mission.program} />
        </dd>
      </dl>
      {report !== null && report.failures.length > 0 && <Failures report={report} />}
      {report !== null && report.robots.length > 0 && <Robots report={report} />}
      <Acts />
    </>
  );
}

function Outcome({ report }: { report: Report }) {
  const details = typeof report.outcome !== "object" || report.outcome === null ? "" : JSON.stringify(Object.values(report.outcome)[0]);
  return (
    <>
      <dt>outcome</dt>
      <dd>
        <Name text={outcomeText(report)} /> {details !== "" && <Name text={details} />}
      </dd>
      <dt>spread</dt>
      <dd id="spread">{inMs(report.spread_ms)}</dd>
      {report.true_spread_ms !== undefined && (
        <>
          <dt>true spread</dt>
          <dd id="true-spread">{inMs(report.true_spread_ms)}</dd>
        </>
      )}
    </>
  );
}

const inMs = (value: number | null) => (value === null ? "–" : `${digits(value)} ms`);

function reasonOf({ text, error, failure }: ReportedFailure): string {
  return text || error || failure.replaceAll("_", " ") || "why is not known";
}

function Failures({ report }: { report: Report }) {
  return (
    <>
      <h2>Failures</h2>
      <ul>
        {report.failures.map((failure, i) => (
          <li key={i} class="error-text">
            ✕ <Name text={[failure.robot, failure.device].filter(Boolean).join(" / ")} /> <Name text={reasonOf(failure)} />
          </li>
        ))}
      </ul>
    </>
  );
}

function Robots({ report }: { report: Report }) {
  return (
    <table id="robots">
      <caption>Robots</caption>
      <thead>
        <tr>
          <th>robot</th>
          <th>standing</th>
          <th class="number">start error</th>
          <th class="number">steps</th>
          <th class="number">late</th>
          <th class="number">clock offset</th>
          <th class="number">known to</th>
        </tr>
      </thead>
      <tbody>
        {report.robots.map((robot, i) => (
          <tr key={i}>
            <th scope="row">
              <Name text={robot.robot} />
            </th>
            <td>
              <Name text={robot.standing || "–"} />
            </td>
            <td class="number">{inMs(robot.start_error_ms)}</td>
            <td class="number">
              {digits(robot.steps_done)}/{digits(robot.steps_planned)}
            </td>
            <td class={(robot.late_steps ?? 0) > 0 ? "number warn-text" : "number"}>
              {(robot.late_steps ?? 0) > 0 && "⚠ "}
              {digits(robot.late_steps)}
            </td>
            <td class="number">{inMs(robot.clock?.offset_ms ?? null)}</td>
            <td class="number">{robot.clock === null ? "–" : `± ${inMs(robot.clock.uncertainty_ms)}`}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

interface ActRow {
  name: string;
  fate: string;
  spread: number | null;
  robots: number | null;
}

/** Acts in the order in which they were sent, then the acts of the scenario that were not sent or not sent again. */
function rowsOf({ acts, report, scenario }: Mission & { report: Report | null }): ActRow[] {
  const fateOf = new Map(acts.map((act) => [act.number, act.fate === undefined ? "–" : fateText(act)]));
  const reported = report?.acts ?? [];
  const sent = reported.map(({ act, number, spread_ms, robots }) => ({
    name: act || (number === null ? "act" : nameOfAct({ name: "", number })),
    fate: (number === null ? undefined : fateOf.get(number)) ?? "–",
    spread: spread_ms,
    robots: robots.filter((robot) => !robot.left_out).length,
  }));
  const numbers = new Set(reported.map(({ number }) => number));
  const unreported = acts
    .filter(({ number }) => !numbers.has(number))
    .map((act) => ({
      name: nameOfAct(act),
      fate: act.fate === undefined ? "–" : fateText(act),
      spread: null,
      robots: act.robots.filter((robot) => !robot.left_out).length,
    }));
  const known = new Set([...acts.map(({ name }) => name), ...reported.map(({ act }) => act)]);
  // The only act of a scenario without acts has no name in the course, but has the scenario's name if it was sent.
  const skipped = (report?.course ?? [])
    .map((act) => ({ ...act, act: act.act || scenario }))
    .filter(({ act, fate }) => !(known.has(act) && SENT.has(fate)))
    .map((act) => ({ name: act.act || "act", fate: courseText(act), spread: null, robots: null }));
  return [...sent, ...unreported, ...skipped];
}

/** Acts with these fates are already listed where they were played. */
const SENT = new Set(["played", "stopped", "withdrawn", "unknown"]);

function Acts() {
  const rows = rowsOf(useSession().show.mission);
  if (rows.length === 0) return null;
  return (
    <table id="acts">
      <caption>Acts</caption>
      <thead>
        <tr>
          <th>act</th>
          <th>what became of it</th>
          <th class="number">spread</th>
          <th class="number">robots</th>
        </tr>
      </thead>
      <tbody>
        {rows.map((act, i) => (
          <tr key={i}>
            <th scope="row">
              <Name text={act.name} />
            </th>
            <td>
              <Name text={act.fate} />
            </td>
            <td class="number">{inMs(act.spread)}</td>
            <td class="number">{digits(act.robots)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
