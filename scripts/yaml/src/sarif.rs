//! Writes findings as SARIF 2.1.0 (OASIS, 2020), the format that code hosts read to annotate files.

use serde_json::{Value, json};

use crate::finding::{Code, Finding, Related, Severity};

/// Converts the findings to a SARIF document with one run, which has a rule for each code that occurs.
#[must_use]
pub fn sarif(findings: &[Finding]) -> Value {
    let mut codes: Vec<Code> = findings.iter().map(|finding| finding.code).collect();
    codes.sort_unstable();
    codes.dedup();
    let rules: Vec<Value> = codes.iter().map(|code| rule(*code)).collect();
    let results: Vec<Value> = findings.iter().map(|finding| result(finding, &codes)).collect();
    json!({
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{
            "tool": {"driver": {
                "name": "downbeat",
                "version": env!("CARGO_PKG_VERSION"),
                "rules": rules,
            }},
            "columnKind": "unicodeCodePoints",
            "results": results,
        }],
    })
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
    }
}

fn rule(code: Code) -> Value {
    json!({
        "id": code.as_str(),
        "shortDescription": {"text": code.title()},
        "fullDescription": {"text": code.explanation()},
        "defaultConfiguration": {"level": level(code.severity())},
    })
}

fn result(finding: &Finding, codes: &[Code]) -> Value {
    let mut text = format!("{}: expected {}", finding.message, finding.expected);
    if let Some(hint) = &finding.hint {
        text.push_str(&format!(". {hint}"));
    }
    // A relative reference: a URI contains no backslashes and no spaces.
    let uri = finding.file.replace('\\', "/").replace('%', "%25").replace(' ', "%20");
    let mut location = json!({"artifactLocation": {"uri": uri}});
    if finding.line > 0 {
        location["region"] = json!({
            "startLine": finding.line,
            "startColumn": finding.column.max(1),
            "endColumn": finding.column.max(1) + finding.width.max(1),
        });
    }
    let related: Vec<Value> = finding.related.iter().map(|place| related(&uri, place)).collect();
    json!({
        "ruleId": finding.code.as_str(),
        "ruleIndex": codes.binary_search(&finding.code).unwrap_or(0),
        "level": level(finding.severity),
        "message": {"text": text},
        "locations": [{"physicalLocation": location}],
        "relatedLocations": related,
    })
}

fn related(uri: &str, place: &Related) -> Value {
    json!({
        "message": {"text": place.message},
        "physicalLocation": {
            "artifactLocation": {"uri": uri},
            "region": {
                "startLine": place.line,
                "startColumn": place.column.max(1),
                "endColumn": place.column.max(1) + place.width.max(1),
            },
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finding_becomes_sarif_result_with_rule_and_position() {
        let mut finding =
            Finding::about_file(Code::OffGranularity, "my show.yaml", "off".into(), "on", Some("fix".into()));
        (finding.line, finding.column, finding.width) = (3, 5, 4);
        let sarif = sarif(&[finding]);
        let run = &sarif["runs"][0];
        assert_eq!(run["tool"]["driver"]["rules"][0]["id"], "DB0012");
        let result = &run["results"][0];
        assert_eq!(result["message"]["text"], "off: expected on. fix");
        let place = &result["locations"][0]["physicalLocation"];
        assert_eq!(place["artifactLocation"]["uri"], "my%20show.yaml");
        assert_eq!(place["region"], json!({"startLine": 3, "startColumn": 5, "endColumn": 9}));
    }
}
