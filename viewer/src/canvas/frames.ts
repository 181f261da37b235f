// One redraw for all changes since the last frame.

const waiting = new Set<() => void>();

export function redraw(draw: () => void): void {
  if (waiting.size === 0) requestAnimationFrame(run);
  waiting.add(draw);
}

function run(): void {
  const draws = [...waiting];
  waiting.clear();
  for (const draw of draws) draw();
}
