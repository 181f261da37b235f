// The outcome of the mission: what became of each robot and each act, and how accurate the starts were.
import { budget, clockUncertainty } from "../data/verdict";
import { nameOfAct } from "../data/fate";
import { gravity, robotStates, type RobotState } from "../data/robots";
import type { Mission, Report, ReportedFailure } from "../mission";
import { seekAndShow } from "../state/moves";
import { useSession, type Session } from "../state/session";
import { aligned, exactly, shortClock, time } from "../text/amount";
import { digits } from "../text/digits";
import { courseText, fateText } from "../text/fate";
import { Name } from "../text/Name";
import { clock, duration, timeOfDay } from "../text/time";
import { Limited } from "./Limited";
import { outcomeText } from "./outcome";

export function Summary() {
  const { mission } = useSession().show;
  const { report } = mission;
  return (
    <>
      {report !== null && <Outcome report={report} />}
      {report !== null && report.failures.length > 0 && <Failures report={report} />}
      <Robots />
      <Requirements />
      <Acts />
      <Facts />
    </>
  );
}

function Outcome({ report }: { report: Report }) {
  const { show } = useSession();
  const details = detailsOf(report.outcome);
  const { predicted, allowed } = budget(show);
  const uncertainty = clockUncertainty(show);
  return (
    <dl class="facts" id="outcome">
      <dt>outcome</dt>
      <dd>
        <Name text={`${outcomeText(report)}${details === "" ? "" : `: ${details}`}`} />
      </dd>
      <dt>starts apart</dt>
      <dd>
        <span id="spread" title={exactly(report.spread_ms)}>
          {time(report.spread_ms)}
        </span>{" "}
        by the robots' own clocks
        {uncertainty !== null && report.spread_ms !== null && `, which are known to ±${time(uncertainty)}`}
        {(predicted !== null || allowed !== null) && "; "}
        {predicted !== null && `predicted at most ${time(predicted)}`}
        {predicted !== null && allowed !== null && ", "}
        {allowed !== null && `allowed ${time(allowed)}`}
      </dd>
      {report.true_spread_ms !== undefined && (
        <>
          <dt>truly apart</dt>
          <dd>
            <span id="true-spread" title={exactly(report.true_spread_ms)}>
              {time(report.true_spread_ms)}
            </span>{" "}
            by the clock of the virtual world, which no real mission can read
          </dd>
        </>
      )}
    </dl>
  );
}

/** The details of an outcome: "late 109 ms, tolerance 10 ms". */
function detailsOf(outcome: Report["outcome"]): string {
  const details = typeof outcome === "object" && outcome !== null ? Object.values(outcome)[0] : null;
  if (typeof details !== "object" || details === null) return "";
  return Object.entries(details)
    .map(([key, value]) => (key.endsWith("_ms") && typeof value === "number" ? `${key.slice(0, -3)} ${time(value)}` : `${key} ${String(value)}`))
    .join(", ")
    .replaceAll("_", " ");
}

function Facts() {
  const { mission } = useSession().show;
  const devices = mission.robots.flatMap((robot) => robot.devices).length;
  const bodies = mission.robots.filter(({ body }) => body !== null).length;
  const dry = mission.kind === "dry_run";
  return (
    <dl class="facts" id="facts">
      <dt>scenario</dt>
      <dd>
        <Name text={mission.scenario} />
      </dd>
      <dt>robots</dt>
      <dd>
        {mission.robots.length}, {bodies} with a body, {devices} devices
      </dd>
      {!dry && (
        <>
          <dt>0:00.000</dt>
          <dd title={mission.epoch}>is {timeOfDay(mission.epoch, 0)} on this computer's clock</dd>
        </>
      )}
      <dt>{dry ? "lasts" : "recorded"}</dt>
      <dd>
        {clock(mission.from)} to {clock(mission.to)} ({duration(mission.to - mission.from)})
      </dd>
      <dt>written by</dt>
      <dd>
        <Name text={mission.program} />
      </dd>
    </dl>
  );
}

function reasonOf({ text, error, failure }: ReportedFailure): string {
  return text || error || failure.replaceAll("_", " ") || "the reason is not known";
}

function Failures({ report }: { report: Report }) {
  const session = useSession();
  const states = robotStates(session.show);
  const when = (robot: string) => states.find(({ id }) => id === robot)?.failure?.at ?? null;
  return (
    <>
      <h2>Failures</h2>
      <ul id="failures">
        {report.failures.map((failure, i) => (
          <li key={i} class="error-text">
            ✕ <At session={session} ms={when(failure.robot)} />
            <Name text={[failure.robot, failure.device].filter(Boolean).join(" / ")} /> <Name text={reasonOf(failure)} />
          </li>
        ))}
      </ul>
    </>
  );
}

function At({ session, ms }: { session: Session; ms: number | null }) {
  if (ms === null) return null;
  return (
    <>
      <button type="button" class="link" onClick={() => seekAndShow(session, ms)}>
        {shortClock(ms)}
      </button>{" "}
    </>
  );
}

function Requirements() {
  const requirements = useSession().show.mission.report?.requirements ?? [];
  if (requirements.length === 0) return null;
  return (
    <table id="requirements">
      <caption>Requirements</caption>
      <thead>
        <tr>
          <th>requirement</th>
          <th class="number">found</th>
          <th>result</th>
        </tr>
      </thead>
      <tbody>
        {requirements.map(({ requirement, bound, value, unit, found, result }, i) => (
          <tr key={i}>
            <th scope="row">
              <Name text={`${requirement} ${bound} ${digits(value)} ${unit}`} />
            </th>
            <td class="number">{found === null ? "not known" : `${digits(found)} ${unit}`}</td>
            <td class={result === "met" ? "" : "warn-text"}>
              {result === "met" ? "✓ " : "⚠ "}
              {result.replaceAll("_", " ")}
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Robots() {
  const { show } = useSession();
  // A stable sort: robots without anything to report keep their order.
  const states = [...robotStates(show)].sort((a, b) => gravity(b) - gravity(a));
  const errors = aligned(states.map(({ startError }) => startError));
  const offsets = aligned(states.map(({ clock }) => clock?.offset_ms ?? null));
  const known = aligned(states.map(({ clock }) => clock?.uncertainty_ms ?? null));
  const stops = states.some(({ stop }) => stop !== null);
  if (states.length === 0) return null;
  return (
    <Limited items={states} name="robots">
      {(some) => (
        <table id="robots">
          <caption>Robots</caption>
          <thead>
            <tr>
              <th>robot</th>
              <th class="number">steps</th>
              <th>late</th>
              {stops && <th>stop</th>}
              <th class="number">start error ({errors.unit})</th>
              <th class="number">clock ({offsets.unit})</th>
              <th class="number">known to ({known.unit})</th>
            </tr>
          </thead>
          <tbody>
            {some.map((state, i) => (
              <tr key={state.robot}>
                <th scope="row">
                  <Name text={state.id} />
                  {state.leftOut && <small class="warn-text"> left out</small>}
                </th>
                <td class="number">
                  {digits(state.stepsDone)} of {digits(state.stepsPlanned)}
                </td>
                <td>
                  <LateOf state={state} />
                </td>
                {stops && (
                  <td class={state.stop !== null && !state.stop.confirmed ? "error-text" : ""}>
                    {state.stop === null ? "–" : `${state.stop.confirmed ? "" : "⚠ "}${state.stop.text}`}
                    {state.stop?.until != null && ` until ${shortClock(state.stop.until)}`}
                  </td>
                )}
                <td class="number" title={exactly(state.startError)}>
                  {errors.cells[i]}
                </td>
                <td class="number" title={exactly(state.clock?.offset_ms)}>
                  {offsets.cells[i]}
                </td>
                <td class="number" title={exactly(state.clock?.uncertainty_ms)}>
                  {state.clock?.uncertainty_ms == null ? "–" : `± ${known.cells[i]}`}
                </td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
    </Limited>
  );
}

/** "⚠ 3 steps, up to 225 ms", with a link to the time. */
function LateOf({ state }: { state: RobotState }) {
  const session = useSession();
  if (state.lateSteps === 0) return <>–</>;
  const first = state.late[0];
  return (
    <span class="warn-text" title={exactly(state.lateMost)}>
      ⚠ {state.lateSteps} step{state.lateSteps === 1 ? "" : "s"}
      {state.lateMost !== null && `, up to ${time(state.lateMost)}`}{" "}
      {first !== undefined && (
        <button type="button" class="link" onClick={() => seekAndShow(session, first.from)}>
          {shortClock(first.from)}–{shortClock(first.to)}
        </button>
      )}
    </span>
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
  const spreads = aligned(rows.map(({ spread }) => spread));
  return (
    <table id="acts">
      <caption>Acts</caption>
      <thead>
        <tr>
          <th>act</th>
          <th>result</th>
          <th class="number">starts apart ({spreads.unit})</th>
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
            <td class="number" title={exactly(act.spread)}>
              {spreads.cells[i]}
            </td>
            <td class="number">{digits(act.robots)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
