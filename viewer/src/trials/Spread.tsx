// Spread of the starts: a histogram with the tolerance and the quantiles.
import type { Histogram, Trials } from "../trials";
import { exactly, time } from "../text/amount";
import { niceStep } from "../text/time";
import { counted } from "./percent";

/** Height of each label above the bars, and of the bars, in pixels. */
const LABEL = 15;
const BARS = 150;
/** Share of the width on the right for the missions beyond the bars, in percent. */
const BEYOND = 7;
/** If a tolerance exceeds the range of the bars by more than this factor, it is only labelled, not drawn to scale. */
const IN_SIGHT = 3;

interface Mark { name: string; ms: number; kind: "quantile" | "tolerance" }

export function Spread({ trials: { spread, histogram, acts } }: { trials: Trials }) {
  if (spread === null || histogram === null) {
    return (
      <section aria-labelledby="spread-title">
        <h2 id="spread-title">Spread of the starts</h2>
        <p id="no-spread">In no mission did all robots of an act begin, so there is no spread.</p>
      </section>
    );
  }
  const tolerances = [...new Set(acts.map((act) => act.tolerance_ms))].sort((a, b) => a - b);
  const strictest = tolerances[0];
  const tolerance = tolerances.length > 1 ? "strictest tolerance" : "tolerance";
  const marks: Mark[] = [
    { name: "p50", ms: spread.p50_ms, kind: "quantile" },
    { name: "p99", ms: spread.p99_ms, kind: "quantile" },
    { name: "max", ms: spread.max_ms, kind: "quantile" },
  ];
  if (strictest !== undefined) marks.push({ name: tolerance, ms: strictest, kind: "tolerance" });
  return (
    <section aria-labelledby="spread-title">
      <h2 id="spread-title">Spread of the starts</h2>
      <p class="hint">The largest difference between the true starts of an act, in {counted(spread.count, "mission")}.</p>
      <Chart histogram={histogram} marks={marks} />
      <dl class="facts" id="spread">
        {marks.map(({ name, ms }) => (
          <>
            <dt>{name}</dt>
            <dd title={exactly(ms)}>{time(ms)}</dd>
          </>
        ))}
      </dl>
      <Numbers histogram={histogram} />
    </section>
  );
}

function Chart({ histogram: { width_ms, counts, beyond }, marks }: { histogram: Histogram; marks: Mark[] }) {
  const bars = width_ms * counts.length;
  const seen = marks.filter(({ kind, ms }) => kind === "tolerance" && ms <= bars * IN_SIGHT).map(({ ms }) => ms);
  const end = Math.max(bars, ...seen.map((ms) => ms * 1.02));
  const room = beyond > 0 ? 100 - BEYOND : 100;
  const x = (ms: number) => (ms <= end ? (ms / end) * room : 100 - (beyond > 0 ? BEYOND / 2 : 0));
  const top = marks.length * LABEL;
  const bottom = top + BARS;
  const most = Math.max(1, beyond, ...counts);
  const high = (count: number) => (count === 0 ? 0 : Math.max(1, (count / most) * (BARS - 12)));
  const bar = (from: number, wide: number, count: number, key: string) => (
    <rect key={key} class="bin" x={`${from}%`} width={`${wide}%`} y={bottom - high(count)} height={high(count)} />
  );
  const step = niceStep(end / 5, 1);
  const ticks = Array.from({ length: Math.floor(end / step + 1e-9) + 1 }, (_, i) => i * step);
  const isFar = ({ kind, ms }: Mark) => kind === "tolerance" && ms > end;
  const told = marks.map(({ name, ms }) => `${name} ${time(ms)}`).join(", ");
  return (
    <svg class="histogram" width="100%" height={bottom + 20} role="img" aria-label={`Histogram of the spread: ${told}`}>
      {counts.map((count, i) => count > 0 && bar(((i * width_ms) / end) * room, (width_ms / end) * room, count, String(i)))}
      {beyond > 0 && bar(100 - BEYOND + 1, BEYOND - 1, beyond, "beyond")}
      <line class="axis" x1="0" x2="100%" y1={bottom} y2={bottom} />
      {ticks.map((ms) => (
        <text key={ms} class="tick" x={`${x(ms)}%`} y={bottom + 14} text-anchor={anchor(x(ms))}>
          {Number(ms.toPrecision(6))}
          {ms === 0 ? " ms" : ""}
        </text>
      ))}
      {beyond > 0 && (
        <text class="tick" x="100%" y={bottom + 14} text-anchor="end">
          more
        </text>
      )}
      {marks.map(
        (mark, i) =>
          !isFar(mark) && (
            <line key={mark.name} class={mark.kind} x1={`${x(mark.ms)}%`} x2={`${x(mark.ms)}%`} y1={i * LABEL + 2} y2={bottom} />
          ),
      )}
      {/* After all lines, so that no line crosses a label. */}
      {marks.map((mark, i) => {
        const far = isFar(mark);
        const near = !far && x(mark.ms) < 55;
        return (
          <text
            key={mark.name}
            class={`label ${mark.kind}`}
            x={`${far ? 100 : x(mark.ms)}%`}
            dx={far ? 0 : near ? 4 : -4}
            y={i * LABEL + 12}
            text-anchor={near ? "start" : "end"}
          >
            {mark.name} {time(mark.ms)}{far ? " →" : ""}
          </text>
        );
      })}
    </svg>
  );
}

const anchor = (x: number) => (x < 3 ? "start" : x > 97 ? "end" : "middle");

/** The histogram as a table, for users who cannot see the picture. */
function Numbers({ histogram: { width_ms, counts, beyond } }: { histogram: Histogram }) {
  const edge = (i: number) => `${Number((i * width_ms).toPrecision(9))} ms`;
  return (
    <details>
      <summary>The histogram in numbers</summary>
      <table id="bins">
        <thead>
          <tr>
            <th class="number">from</th>
            <th class="number">to below</th>
            <th class="number">missions</th>
          </tr>
        </thead>
        <tbody>
          {counts.map(
            (count, i) =>
              count > 0 && (
                <tr key={i}>
                  <td class="number">{edge(i)}</td>
                  <td class="number">{edge(i + 1)}</td>
                  <td class="number">{count}</td>
                </tr>
              ),
          )}
          {beyond > 0 && (
            <tr>
              <td class="number">{edge(counts.length)}</td>
              <td class="number">–</td>
              <td class="number">{beyond}</td>
            </tr>
          )}
        </tbody>
      </table>
    </details>
  );
}
