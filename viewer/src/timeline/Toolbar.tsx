// Search, filters, zoom and display options.
import { Icon } from "../panels/Icon";
import { Tool } from "../panels/Tool";
import { useCell } from "../state/cell";
import { foldAll } from "../state/choose";
import { clearSelection, fit, zoom, zoomToSelection } from "../state/moves";
import { NO_FILTER, type Filter } from "../state/rows";
import { useSession } from "../state/session";
import { Picker } from "./Picker";

export function Toolbar() {
  const session = useSession();
  const filter = useCell(session.filter);
  const relations = useCell(session.relations);
  const drag = useCell(session.drag);
  const range = useCell(session.range);
  const cue = useCell(session.cue);
  const { robots, groups } = session.show.mission;
  const change = (part: Partial<Filter>) => (session.filter.value = { ...session.filter.value, ...part });
  const middle = () => (session.view.value.from + session.view.value.to) / 2;
  return (
    <div class="toolbar" role="toolbar" aria-label="Timeline">
      <input
        id="search"
        type="search"
        aria-label="Search robots, devices and cues"
        placeholder="Search  ( / )"
        value={filter.text}
        onInput={(event) => change({ text: event.currentTarget.value })}
      />
      <Picker label="Robot" names={robots.map(({ id }) => id)} value={filter.robot} choose={(robot) => change({ robot })} />
      {groups.length > 0 && (
        <Picker label="Group" names={groups.map(({ name }) => name)} value={filter.group} choose={(group) => change({ group })} />
      )}
      <Picker
        label="Cue"
        names={session.show.cues.map((placed) => placed.cue.name)}
        value={filter.cue}
        choose={(chosen) => change({ cue: chosen })}
      />
      <Tool
        label="Clear filters"
        press={() => (session.filter.value = NO_FILTER)}
        disabled={Object.values(filter).every((part) => part === null || part === "")}
      >
        <Icon name="close" />
      </Tool>
      <span class="gap" />
      <Tool label="Fold or unfold all robots (U)" press={() => foldAll(session)}>
        <Icon name="fold" />
      </Tool>
      <Tool label="Show relations (R)" pressed={relations} press={() => (session.relations.value = !relations)}>
        <Icon name="arrow" />
      </Tool>
      <Tool
        label="Drag selects a range (X)"
        pressed={drag === "select"}
        press={() => (session.drag.value = drag === "select" ? "pan" : "select")}
      >
        <Icon name="range" />
      </Tool>
      <Tool
        label="Zoom to the selected range or cue (Z)"
        disabled={range === null && cue === null}
        press={() => zoomToSelection(session)}
      >
        <Icon name="closer" />
      </Tool>
      <Tool
        label="Clear the selected range and cue (Esc)"
        disabled={range === null && cue === null}
        press={() => clearSelection(session)}
      >
        <Icon name="close" />
      </Tool>
      <Tool label="Zoom out (-)" press={() => zoom(session, 1 / 1.5, middle())}>
        −
      </Tool>
      <Tool label="Zoom in (+)" press={() => zoom(session, 1.5, middle())}>
        +
      </Tool>
      <Tool label="Fit all (F)" press={() => fit(session)}>
        Fit
      </Tool>
    </div>
  );
}
