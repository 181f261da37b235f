// Formatted shares.
import type { Share } from "../trials";

/** In percent, rounded to a hundredth like on the command line. */
export const hundredths = (share: number) => String(Math.round(share * 10_000) / 100);

export const percent = ({ share }: Share) => (share === null ? "none" : `${hundredths(share)} %`);

export const interval = ({ least, largest }: Share) => `${hundredths(least)} to ${hundredths(largest)} %`;

export const counted = (count: number, thing: string) => `${count} ${thing}${count === 1 ? "" : "s"}`;
