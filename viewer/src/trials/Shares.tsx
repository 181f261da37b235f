// Probability that the mission starts and finishes: the four shares that the command line prints first.
import type { Share, Trials } from "../trials";
import { ShareBar } from "./bars";
import { interval, percent } from "./percent";

export function Shares({ trials }: { trials: Trials }) {
  return (
    <section class="wide" aria-labelledby="shares-title">
      <h2 id="shares-title">How missions go</h2>
      <ul class="shares">
        <Card id="starts" what="start" share={trials.starts} bad={false} />
        <Card id="finishes" what="finish as planned" share={trials.finishes} bad={false} />
        <Card id="aborts" what="abort" share={trials.aborts} bad />
        <Card id="mixed" what="some robots start, others do not" share={trials.mixed} bad />
      </ul>
    </section>
  );
}

function Card({ id, what, share, bad }: { id: string; what: string; share: Share; bad: boolean }) {
  return (
    <li id={id}>
      <span>{what}</span>
      <strong>{percent(share)}</strong>
      <ShareBar share={share} bad={bad} />
      <small>
        {share.count} of {share.of}; 95 % interval {interval(share)}
      </small>
    </li>
  );
}
