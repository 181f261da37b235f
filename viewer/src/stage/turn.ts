// Mouse, touch and keys that move the camera; a click selects a robot.
import { closer, orbit, slide, type Camera } from "./camera";

export interface Turning {
  camera: () => Camera;
  look: (camera: Camera) => void;
  reset: () => void;
  click: (x: number, y: number) => void;
}

/** A movement of fewer pixels is a click, not a drag. */
const STILL = 4;

export function listenToTurns(canvas: HTMLCanvasElement, turning: Turning): () => void {
  let before: { x: number; y: number } | null = null;
  let from = { x: 0, y: 0 };
  const down = (event: PointerEvent) => {
    canvas.setPointerCapture(event.pointerId);
    before = from = { x: event.offsetX, y: event.offsetY };
  };
  const move = (event: PointerEvent) => {
    if (before === null) return;
    const right = event.offsetX - before.x;
    const down = event.offsetY - before.y;
    before = { x: event.offsetX, y: event.offsetY };
    const half = Math.min(canvas.clientWidth, canvas.clientHeight) / 2;
    const slides = turning.camera().map || event.shiftKey;
    turning.look(slides ? slide(turning.camera(), -right / half, down / half) : orbit(turning.camera(), -right / 120, down / 120));
  };
  const up = (event: PointerEvent) => {
    const still = before !== null && Math.hypot(event.offsetX - from.x, event.offsetY - from.y) < STILL;
    before = null;
    if (still && event.type === "pointerup") turning.click(event.offsetX, event.offsetY);
  };
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
  if (arrow !== undefined && !camera.map && !event.shiftKey) turning.look(orbit(camera, arrow[0] * 0.15, arrow[1] * 0.1));
  else if (arrow !== undefined) turning.look(slide(camera, arrow[0] * 0.15, arrow[1] * 0.15));
  else if (event.key === "+" || event.key === "=") turning.look(closer(camera, 1.25));
  else if (event.key === "-") turning.look(closer(camera, 0.8));
  else if (event.key === "f") turning.reset();
  else return;
  event.preventDefault();
  event.stopPropagation();
}
