// The files of the mission. The selected cue marks its lines; a line selects the cue that contains it.
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { useCell } from "../state/cell";
import { useSession, type Session } from "../state/session";
import { visible } from "../text/visible";

const LINE = 24;

export function Source() {
  const session = useSession();
  const selected = useCell(session.cue);
  const { sources } = session.show.mission;
  const cue = selected === null ? null : session.show.cues[selected].cue;
  const [file, setFile] = useState(cue?.source ?? 0);
  useEffect(() => {
    if (cue !== null) setFile(cue.source);
  }, [cue]);
  if (sources.length === 0) return <p class="empty">No source files are known.</p>;
  const marks = cue !== null && cue.source === file ? { first: cue.first_line, last: cue.last_line } : null;
  return (
    <>
      <div class="bar">
        <label>
          File{" "}
          <select value={String(file)} onChange={(event) => setFile(Number(event.currentTarget.value))}>
            {sources.map(({ name }, i) => (
              <option key={i} value={String(i)}>
                {visible(name)}
              </option>
            ))}
          </select>
        </label>
        <small>
          {cue === null
            ? "Click a line to select its cue."
            : `cue ${visible(cue.name)}, ${cue.first_line === cue.last_line ? `line ${cue.first_line}` : `lines ${cue.first_line} to ${cue.last_line}`}`}
        </small>
      </div>
      <Lines key={file} text={sources[file]?.text ?? ""} marks={marks} pick={(line) => pick(session, file, line)} />
    </>
  );
}

function pick(session: Session, file: number, line: number): void {
  const cues = session.show.cuesAt(file, line);
  const now = session.cue.value;
  // If an act is played twice, a line belongs to two cues. Another click selects the next one.
  session.cue.value = cues.length === 0 ? null : cues[(cues.indexOf(now ?? -1) + 1) % cues.length];
}

interface LinesProps {
  text: string;
  marks: { first: number; last: number } | null;
  pick: (line: number) => void;
}

function Lines({ text, marks, pick }: LinesProps) {
  const lines = useMemo(() => text.split(/\r?\n/), [text]);
  const box = useRef<HTMLDivElement>(null);
  const [top, setTop] = useState(0);
  const [active, setActive] = useState(marks?.first ?? 1);
  const reveal = (line: number) => {
    const element = box.current;
    if (element === null) return;
    const y = (line - 1) * LINE;
    if (y < element.scrollTop || y + 3 * LINE > element.scrollTop + element.clientHeight)
      element.scrollTop = Math.max(0, y - 2 * LINE);
  };
  useEffect(() => {
    if (marks === null) return;
    reveal(marks.first);
    setActive((line) => (line >= marks.first && line <= marks.last ? line : marks.first));
  }, [marks?.first, marks?.last]);
  const press = (event: KeyboardEvent) => {
    const by = { ArrowUp: -1, ArrowDown: 1, PageUp: -15, PageDown: 15 }[event.key];
    if (by === undefined && event.key !== "Enter") return;
    event.preventDefault();
    event.stopPropagation();
    if (by === undefined) return pick(active);
    const next = Math.min(lines.length, Math.max(1, active + by));
    setActive(next);
    reveal(next);
  };
  const height = box.current?.clientHeight ?? 600;
  const first = Math.max(0, Math.floor(top / LINE) - 10);
  const shown = lines.slice(first, first + Math.ceil(height / LINE) + 20);
  return (
    <div
      class="code"
      ref={box}
      tabIndex={0}
      role="listbox"
      aria-label="Lines of the file"
      aria-activedescendant={active > first && active <= first + shown.length ? `line-${active}` : undefined}
      onScroll={(event) => setTop(event.currentTarget.scrollTop)}
      onKeyDown={press}
    >
      <div class="code-space" role="presentation" style={{ height: `${lines.length * LINE}px` }}>
        {shown.map((line, i) => {
          const number = first + i + 1;
          const marked = marks !== null && number >= marks.first && number <= marks.last;
          return (
            <div
              key={number}
              id={`line-${number}`}
              role="option"
              aria-selected={marked}
              class={`code-line${marked ? " marked" : ""}${number === active ? " active" : ""}`}
              style={{ top: `${(number - 1) * LINE}px` }}
              onClick={() => {
                setActive(number);
                pick(number);
              }}
            >
              <span>{number}</span>
              <bdi>{visible(line)}</bdi>
            </div>
          );
        })}
      </div>
    </div>
  );
}
