// Small bars inside tables and cards. The numbers are next to them as text, so screen readers skip the bars.
import type { Quantiles, Share } from "../trials";

const at = (share: number) => `${Number((Math.min(1, Math.max(0, share)) * 100).toFixed(3))}%`;

/** A share from 0 to 1, and the interval that contains its probability. */
export function ShareBar({ share, bad }: { share: Share; bad: boolean }) {
  return (
    <svg class={bad ? "share-bar bad" : "share-bar"} width="100%" height="16" aria-hidden="true">
      <rect class="track" x="0" y="5" width="100%" height="6" />
      {share.share !== null && <rect class="value" x="0" y="5" width={at(share.share)} height="6" />}
      <line class="interval" x1={at(share.least)} x2={at(share.largest)} y1="8" y2="8" />
      <line class="interval-end" x1={at(share.least)} x2={at(share.least)} y1="2" y2="14" />
      <line class="interval-end" x1={at(share.largest)} x2={at(share.largest)} y1="2" y2="14" />
    </svg>
  );
}

/** Thick up to the median, thin up to the 99th percentile, and a mark at the maximum. 0 is on the left, `end` on the right. */
export function RangeBar({ range, end }: { range: Quantiles; end: number }) {
  const x = (ms: number) => at(end > 0 ? ms / end : 0);
  return (
    <svg class="range-bar" width="100%" height="16" aria-hidden="true">
      <line class="track" x1="0" x2="100%" y1="8" y2="8" />
      <line class="most" x1="0" x2={x(range.p99_ms)} y1="8" y2="8" />
      <line class="half" x1="0" x2={x(range.p50_ms)} y1="8" y2="8" />
      <line class="largest" x1={x(range.max_ms)} x2={x(range.max_ms)} y1="3" y2="13" />
    </svg>
  );
}
