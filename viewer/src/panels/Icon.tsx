// Icons of buttons. They are drawn here because fonts differ in the symbols they contain.

const PATHS = {
  first: "M3 3h2v10H3zM13 3v10L6 8z",
  back: "M12 3v10L4 8z",
  play: "M4 2v12l10-6z",
  pause: "M4 3h3v10H4zM9 3h3v10H9z",
  forward: "M2 3v10l6-5zM8 3v10l6-5z",
  last: "M11 3h2v10h-2zM3 3v10l7-5z",
  stepBefore: "M13 3v10h-1.5V3zM10 3v10L4 8z",
  stepAfter: "M3 3h1.5v10H3zM6 3l6 5-6 5z",
  sun: "M8 5a3 3 0 1 0 0 6 3 3 0 0 0 0-6zM7.3 1h1.4v2.5H7.3zM7.3 12.5h1.4V15H7.3zM1 7.3h2.5v1.4H1zM12.5 7.3H15v1.4h-2.5zM2.6 3.6l1-1 1.7 1.7-1 1zM10.7 11.7l1-1 1.7 1.7-1 1zM3.6 13.4l-1-1 1.7-1.7 1 1zM11.7 5.3l-1-1 1.7-1.7 1 1z",
  moon: "M10 1.5A6.5 6.5 0 1 0 14.5 10 5.5 5.5 0 0 1 10 1.5z",
  fold: "M8 1l4 4H4zM8 15l-4-4h8zM2 7.3h12v1.4H2z",
  arrow: "M2 3h3a3 3 0 0 1 3 3v3h2.5V6.5L15 10l-4.5 3.5V11H6V6a1 1 0 0 0-1-1H2z",
  range: "M1 2h1.5v12H1zM13.5 2H15v12h-1.5zM4 5h2v1.5H4zM7 5h2v1.5H7zM10 5h2v1.5h-2zM4 9.5h2V11H4zM7 9.5h2V11H7zM10 9.5h2V11h-2z",
  closer: "M1.5 1.5h5V3H4l3 3-1 1-3-3v2.5H1.5zM14.5 14.5h-5V13H12l-3-3 1-1 3 3V9.5h1.5z",
  close: "M3 4l1-1 4 4 4-4 1 1-4 4 4 4-1 1-4-4-4 4-1-1 4-4z",
} as const;

export function Icon({ name }: { name: keyof typeof PATHS }) {
  return (
    <svg class="icon" viewBox="0 0 16 16" width="14" height="14" aria-hidden="true">
      <path d={PATHS[name]} fill="currentColor" />
    </svg>
  );
}
