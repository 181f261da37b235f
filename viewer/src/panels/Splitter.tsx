// A border between panels that can be dragged, or moved with the arrow keys.
import { useRef, useState } from "preact/hooks";

/** Shares of the window that the first part can take, in percent. */
const [LEAST, MOST] = [15, 85];
const KEY_STEP = 3;

/** "column": between the details and the rest; "row": between the upper panels and the timeline. */
export function Splitter({ direction }: { direction: "column" | "row" }) {
  const line = useRef<HTMLDivElement>(null);
  const [share, setShare] = useState(direction === "column" ? 38 : 46);
  const move = (next: number) => {
    const within = Math.min(MOST, Math.max(LEAST, next));
    setShare(within);
    line.current?.parentElement?.style.setProperty(`--${direction}`, `${within}%`);
  };
  const drag = (event: PointerEvent) => {
    const box = line.current?.parentElement?.getBoundingClientRect();
    if (event.buttons !== 1 || box === undefined) return;
    const at = direction === "column" ? (event.clientX - box.left) / box.width : (event.clientY - box.top) / box.height;
    move(100 * at);
  };
  const press = (event: KeyboardEvent) => {
    const by = { ArrowLeft: -KEY_STEP, ArrowUp: -KEY_STEP, ArrowRight: KEY_STEP, ArrowDown: KEY_STEP }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    move(share + by);
  };
  return (
    <div
      ref={line}
      class={`splitter ${direction}`}
      role="separator"
      tabIndex={0}
      aria-label={direction === "column" ? "Width of the details" : "Height of the upper panels"}
      aria-orientation={direction === "column" ? "vertical" : "horizontal"}
      aria-valuenow={Math.round(share)}
      aria-valuemin={LEAST}
      aria-valuemax={MOST}
      onPointerDown={(event) => event.currentTarget.setPointerCapture(event.pointerId)}
      onPointerMove={drag}
      onKeyDown={press}
    />
  );
}
