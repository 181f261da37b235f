// Requirements of the scenario, and whether they are met.
import { rounded, withUnit } from "../text/digits";
import { Name } from "../text/Name";
import type { Requirement } from "../trials";
import { Wide } from "./Wide";

const RESULTS = { met: "met", not_met: "not met", not_known: "not known" };
const BADGES = { met: "badge good", not_met: "badge bad", not_known: "badge" };

export function Required({ requirements }: { requirements: readonly Requirement[] }) {
  if (requirements.length === 0) return null;
  return (
    <section class="wide" aria-labelledby="required-title">
      <h2 id="required-title">Requirements</h2>
      <Wide label="requirements">
        <table id="requirements">
          <thead>
            <tr>
              <th>requirement</th>
              <th class="number">required</th>
              <th class="number">found</th>
              <th>result</th>
              <th>note</th>
            </tr>
          </thead>
          <tbody>
            {requirements.map(({ requirement, bound, value, unit, found, result, note }) => (
              <tr key={requirement}>
                <th scope="row">{requirement.replaceAll("_", " ")}</th>
                <td class="number">
                  {bound} {withUnit(rounded(value, 6), unit)}
                </td>
                <td class="number">{found === null ? "–" : withUnit(rounded(found, 6), unit)}</td>
                <td>
                  <span class={BADGES[result]}>{RESULTS[result]}</span>
                </td>
                <td class="said">{note !== undefined && <Name text={note} />}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </Wide>
    </section>
  );
}

/** A summary of all requirements. */
export function RequiredBadge({ requirements }: { requirements: readonly Requirement[] }) {
  if (requirements.length === 0) return null;
  const unmet = requirements.filter(({ result }) => result === "not_met").length;
  const unknown = requirements.filter(({ result }) => result === "not_known").length;
  if (unmet > 0) return <span class="badge bad">{`${unmet} of ${requirements.length} requirements not met`}</span>;
  if (unknown > 0) return <span class="badge">{`${unknown} of ${requirements.length} requirements not known`}</span>;
  return <span class="badge good">{requirements.length === 1 ? "requirement met" : "requirements met"}</span>;
}
