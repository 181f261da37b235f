// Mouse, touch and keys that move the camera.
import { closer, orbit, slide, type Camera } from "./camera";

export interface Turning {
  camera: () => Camera;
  in3d: () => boolean;
  look: (camera: Camera) => void;
  reset: () => void;
}

export function listenToTurns(canvas: HTMLCanvasElement, turning: Turning): () => void {
  let before: { x: number; y: number } | null = null;
  const down = (event: PointerEvent) => {
    canvas.setPointerCapture(event.pointerId);
    before = { x: event.offsetX, y: event.offsetY };
  };
  const move = (event: PointerEvent) => {
    if (before === null) return;
    const right = event.offsetX - before.x;
    const down = event.offsetY - before.y;
    before = { x: event.offsetX, y: event.offsetY };
    const half = Math.min(canvas.clientWidth, canvas.clientHeight) / 2;
    const slides = !turning.in3d() || event.shiftKey;
    turning.look(
      slides
        ? slide(turning.camera(), -right / half, down / half, turning.in3d())
        : orbit(turning.camera(), -right / 120, down / 120),
    );
  };
  const up = () => (before = null);
  const wheel = (event: WheelEvent) => {
    event.preventDefault();
    turning.look(closer(turning.camera(), Math.exp(-event.deltaY / 400)));
  };
  const listeners = {
    pointerdown: down,
    pointermove: move,
    pointerup: up,
    pointercancel: up,
    wheel,
    keydown: (event: KeyboardEvent) => press(event, turning),
  };
  for (const [name, listener] of Object.entries(listeners))
    canvas.addEventListener(name, listener as EventListener, { passive: false });
  return () => {
    for (const [name, listener] of Object.entries(listeners)) canvas.removeEventListener(name, listener as EventListener);
  };
}

function press(event: KeyboardEvent, turning: Turning): void {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const way: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const camera = turning.camera();
  const arrow = way[event.key];
  if (arrow !== undefined && turning.in3d() && !event.shiftKey) turning.look(orbit(camera, arrow[0] * 0.15, arrow[1] * 0.1));
  else if (arrow !== undefined) turning.look(slide(camera, arrow[0] * 0.15, arrow[1] * 0.15, turning.in3d()));
  else if (event.key === "+" || event.key === "=") turning.look(closer(camera, 1.25));
  else if (event.key === "-") turning.look(closer(camera, 0.8));
  else if (event.key === "f") turning.reset();
  else return;
  event.preventDefault();
  event.stopPropagation();
}
