//! `downbeat explain`: explains a finding, given its code.

use downbeat_scripts::{Code, Severity};

use super::{Exit, Format, console};

/// Explain the code of a finding in detail.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat explain DB0012
  downbeat explain           list all codes")]
pub(super) struct ExplainArgs {
    /// The code, as it is printed with a finding. Without it, all codes are listed.
    code: Option<String>,
}

pub(super) fn explain(args: &ExplainArgs, format: Format) -> Exit {
    let Some(wanted) = &args.code else { return list(format) };
    let wanted = wanted.to_uppercase();
    let Some(code) = Code::ALL.iter().find(|code| code.as_str() == wanted) else {
        let numbered = wanted.parse::<u32>().ok().map(|number| format!("DB{number:04}"));
        let meant = numbered.filter(|code| Code::ALL.iter().any(|known| known.as_str() == code));
        let meant = meant.map(|code| format!("did you mean `{code}`? ")).unwrap_or_default();
        console::error(&format!("unknown code `{wanted}`; {meant}`downbeat explain` lists all codes"));
        return Exit::Usage;
    };
    match format {
        Format::Json => console::print_json(&described(*code)),
        Format::Text => {
            let kind = word(*code);
            console::print(&format!(
                "{} ({kind}): {}\n\n{}\n",
                code.as_str(),
                code.title(),
                code.explanation()
            ));
        }
    }
    Exit::Done
}

fn word(code: Code) -> &'static str {
    match code.severity() {
        Severity::Error => "error",
        Severity::Warning => "warning",
    }
}

fn described(code: Code) -> serde_json::Value {
    serde_json::json!({
        "code": code.as_str(),
        "severity": code.severity(),
        "title": code.title(),
        "explanation": code.explanation(),
    })
}

fn list(format: Format) -> Exit {
    match format {
        Format::Json => {
            let all: Vec<_> = Code::ALL.iter().map(|code| described(*code)).collect();
            console::print_json(&all);
        }
        Format::Text => {
            let line = |code: &Code| format!("{}  {:<7}  {}\n", code.as_str(), word(*code), code.title());
            console::print(&Code::ALL.iter().map(line).collect::<String>());
        }
    }
    Exit::Done
}
