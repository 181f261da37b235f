// Names of the rows: foldable robots and their devices. Only visible rows are in the document.
import { useEffect, useState, type MutableRef } from "preact/hooks";
import { useCell } from "../state/cell";
import { choose, focusRow, fold } from "../state/choose";
import { useSession, type Session } from "../state/session";
import { groupsOfRows, type Row } from "../state/rows";
import { Name } from "../text/Name";
import { HEAD_HEIGHT } from "./head";

interface TreeProps {
  scroller: MutableRef<HTMLDivElement | null>;
  scrolled: () => void;
}

export function Tree({ scroller, scrolled }: TreeProps) {
  const session = useSession();
  const rows = useCell(session.rows);
  const focused = useCell(session.focusedRow);
  useCell(session.chosen);
  const [window, setWindow] = useState({ top: 0, height: 800 });
  const look = () => {
    const { scrollTop, clientHeight } = scroller.current ?? { scrollTop: 0, clientHeight: 800 };
    setWindow({ top: scrollTop, height: clientHeight });
    scrolled();
  };
  useEffect(look, [rows]);
  useEffect(() => keepInSight(scroller.current, rows[focused]), [focused]);
  const last = rows[rows.length - 1];
  const inSight = (row: Row, index: number) =>
    index === focused || (row.top + row.height >= window.top - 200 && row.top <= window.top + window.height + 200);
  return (
    <div class="rows" ref={scroller} onScroll={look}>
      <div class="rows-head" aria-hidden="true">
        <span>time</span>
        <span>acts</span>
        <span>agreement</span>
        <span>events</span>
      </div>
      <div class="rows-space" style={{ height: `${last === undefined ? 0 : last.top + last.height}px` }}>
        {rows[0]?.kind === "cues" && (
          <div class="row-name row-cues" style={{ top: 0, height: `${rows[0].height}px` }}>
            cues
          </div>
        )}
        <div role="tree" aria-label="Robots and devices" onKeyDown={(event) => treeKey(session, event)}>
          {rows.map(
            (row, index) =>
              row.kind !== "cues" &&
              inSight(row, index) && (
                <RowName
                  key={row.kind === "robot" ? `r${row.robot}` : row.kind === "group" ? `g${row.group}` : `t${row.track.index}`}
                  row={row}
                  index={index}
                  session={session}
                />
              ),
          )}
        </div>
        {last === undefined && <p class="empty">No robot or cue passes the filters.</p>}
      </div>
    </div>
  );
}

interface RowNameProps {
  row: Exclude<Row, { kind: "cues" }>;
  index: number;
  session: Session;
}

function RowName({ row, index, session }: RowNameProps) {
  const lane = row.kind === "lane";
  const chosen = lane && session.chosen.value.includes(row.track);
  const tabIndex = index === session.focusedRow.value || (index === firstItem(session) && !itemFocused(session)) ? 0 : -1;
  return (
    <div
      role="treeitem"
      id={`row-${index}`}
      class={`row-name row-${row.kind}${index === session.focusedRow.value ? " row-focused" : ""}`}
      style={{ top: `${row.top}px`, height: `${row.height}px` }}
      tabIndex={tabIndex}
      aria-level={levelOf(session, row)}
      aria-expanded={lane ? undefined : !row.folded}
      aria-selected={lane ? chosen : undefined}
      onClick={() => {
        focusRow(session, index);
        if (lane) choose(session, row.track);
        else fold(session, row);
      }}
      onFocus={() => focusRow(session, index)}
    >
      {lane ? (
        <>
          <span class="box" aria-hidden="true">
            {chosen ? "☑" : "☐"}
          </span>
          <Name text={row.track.name} />
          <small>
            <Name text={row.track.device.unit} />
          </small>
        </>
      ) : (
        <>
          <span class="box" aria-hidden="true">
            {row.folded ? "▸" : "▾"}
          </span>
          <Name text={row.kind === "group" ? session.show.mission.groups[row.group].name : session.show.mission.robots[row.robot].id} />
          <small>{row.kind === "group" ? `${row.robots.length} robots` : row.tracks.length}</small>
        </>
      )}
    </div>
  );
}

/** Groups, their robots and their lanes; without groups, robots and their lanes. */
function levelOf({ show }: Session, row: RowNameProps["row"]): number {
  if (row.kind === "group") return 1;
  const robot = row.kind === "robot" ? row.robot : row.track.robotIndex;
  return (groupsOfRows(show).has(robot) ? 2 : 1) + (row.kind === "lane" ? 1 : 0);
}

const firstItem = (session: Session) => session.rows.value.findIndex((row) => row.kind !== "cues");
const itemFocused = (session: Session) => {
  const row = session.rows.value[session.focusedRow.value];
  return row !== undefined && row.kind !== "cues";
};

function keepInSight(scroller: HTMLElement | null, row: Row | undefined): void {
  if (scroller === null || row === undefined) return;
  const room = scroller.clientHeight - HEAD_HEIGHT;
  if (row.top < scroller.scrollTop) scroller.scrollTop = row.top;
  else if (row.top + row.height > scroller.scrollTop + room) scroller.scrollTop = row.top + row.height - room;
}

/** Keys of a tree according to the ARIA practices. All other keys keep their meaning on the page. */
function treeKey(session: Session, event: KeyboardEvent): void {
  const row = session.rows.value[session.focusedRow.value];
  if (row === undefined || row.kind === "cues" || event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.key === "Enter") {
    if (row.kind === "lane") choose(session, row.track);
    else fold(session, row);
  } else if (row.kind !== "lane" && event.key === (row.folded ? "ArrowRight" : "ArrowLeft") && !event.shiftKey) {
    fold(session, row);
  } else {
    return;
  }
  event.preventDefault();
  event.stopPropagation();
}
