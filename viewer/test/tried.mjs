// A document of trials, as `scheduler/history/src/page/tried.rs` writes it.

const share = (count, of) => ({
  count,
  of,
  share: of === 0 ? null : count / of,
  least: of === 0 ? 0 : Math.max(0, count / of - 0.03),
  largest: of === 0 ? 1 : Math.min(1, count / of + 0.03),
});
const quantiles = (count, p50_ms, p99_ms, max_ms) => ({ count, p50_ms, p99_ms, max_ms });

export function tried({ trials = 300, robots = 6 } = {}) {
  const of = (part) => share(Math.round(trials * part), trials);
  const robot = (i) => `cf${i + 1}`;
  return {
    version: 1,
    program: "downbeat 0.1.0",
    kind: "trials",
    scenario: "swap",
    world: "friday-night",
    trials,
    seed: "18446744073709551615",
    replay: ["downbeat", "dry-run", "show.yaml", "--world", "it's friday.yaml", "--seed", "18446744073709551615"],
    starts: of(0.97),
    finishes: of(0.9),
    aborts: of(0.1),
    mixed: of(0.01),
    outcomes: [
      ["done", of(0.9)],
      ["not_started", of(0.06)],
      ["failed", of(0.03)],
      ["done_without", of(0.01)],
    ],
    spread: quantiles(trials, 0.892545, 3.411043, 60.5),
    histogram: { width_ms: 0.2, counts: Array.from({ length: 52 }, (_, i) => (i > 20 ? 0 : 1 + ((i * 7) % 20))), beyond: 2 },
    acts: [
      { act: "swap", starts: of(0.97), spread: quantiles(trials, 0.8, 3.4, 60.5), tolerance_ms: 5, beyond_tolerance: of(0.01) },
      { act: "finale", starts: share(0, 0), spread: null, tolerance_ms: 8, beyond_tolerance: share(0, 0) },
    ],
    lead: { had: quantiles(290, 392.54927, 2341.735476, 2350.132742), enough: quantiles(290, 293.836375, 1842.06124, 1849.618799), undecided: 10 },
    reasons: Array.from({ length: Math.min(robots, 400) }, (_, i) => ({
      robot: i === 2 ? null : robot(i),
      kind: i === 2 ? "out_of_tolerance" : "link_down",
      share: of(0.05 / (i + 1)),
      example: 11 * i,
      text: `link down: connection ${i} refused`,
    })),
    robots: Array.from({ length: robots }, (_, i) => ({
      robot: robot(i),
      fails_first: of(0.05 / (i + 1)),
      accepts_within: i === 5 ? null : quantiles(trials, 1.3 + i, 200.61117 - i, 201.618551 + i),
      accepts_last: of(1 / robots),
      reconnects: of(0.02),
    })),
    weakest_robot: "cf1",
    weakest_link: "cf5",
    requirements: [
      { requirement: "spread_p99", bound: "below", value: 5, unit: "ms", found: 3.411043, result: "met" },
      { requirement: "starts", bound: "above", value: 99.9, unit: "%", found: 97, result: "not_met" },
      { requirement: "closest", bound: "at least", value: 0.3, unit: "m", found: null, result: "not_known", note: "robots were left out" },
    ],
  };
}
