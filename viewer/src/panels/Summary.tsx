// How the mission went, in the digits of the report.
import type { Report } from "../mission";
import { useSession } from "../state/session";
import { digits } from "../text/digits";
import { Name } from "../text/Name";
import { clock, duration } from "../text/time";
import { outcomeText } from "./outcome";

export function Summary() {
  const { mission, tracks } = useSession().show;
  const { report } = mission;
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
          {mission.robots.length}, {bodies} with a body, {tracks.length} devices
        </dd>
        {report !== null && <Outcome report={report} />}
        <dt>written by</dt>
        <dd>
          <Name text={mission.program} />
        </dd>
      </dl>
      {report !== null && report.failures.length > 0 && <Failures report={report} />}
      {report !== null && <Robots report={report} />}
      {report !== null && <Acts report={report} />}
    </>
  );
}

function Outcome({ report }: { report: Report }) {
  const details = typeof report.outcome === "string" ? "" : JSON.stringify(Object.values(report.outcome)[0]);
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

function Failures({ report }: { report: Report }) {
  return (
    <>
      <h2>Failures</h2>
      <ul>
        {report.failures.map(({ robot, device, message }, i) => (
          <li key={i} class="error-text">
            ✕ <Name text={[robot, device].filter(Boolean).join(" / ")} /> <Name text={message ?? ""} />
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
              <Name text={robot.standing} />
            </td>
            <td class="number">{inMs(robot.start_error_ms)}</td>
            <td class="number">
              {digits(robot.steps_done)}/{digits(robot.steps_planned)}
            </td>
            <td class={robot.late_steps > 0 ? "number warn-text" : "number"}>
              {robot.late_steps > 0 && "⚠ "}
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

function Acts({ report }: { report: Report }) {
  return (
    <table>
      <caption>Acts</caption>
      <thead>
        <tr>
          <th>act</th>
          <th class="number">spread</th>
          <th class="number">robots</th>
        </tr>
      </thead>
      <tbody>
        {report.acts.map((act, i) => (
          <tr key={i}>
            <th scope="row">
              <Name text={act.act} />
            </th>
            <td class="number">{inMs(act.spread_ms)}</td>
            <td class="number">{act.robots.filter((robot) => !robot.left_out).length}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
