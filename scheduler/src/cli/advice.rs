//! Guesses which arguments the user intended if they cannot be parsed, and adds tips below clap's own message.

use std::path::Path;

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, CommandFactory};
use downbeat_scripts::did_you_mean;

use super::Cli;

/// Names that other programs use for commands, with the corresponding command of this program.
const COMMANDS: [(&str, &str); 15] = [
    ("abort", "stop"),
    ("list", "missions"),
    ("lint", "check"),
    ("new", "init"),
    ("ping", "fleet ping"),
    ("play", "run"),
    ("rehearse", "dry-run"),
    ("show", "fleet show"),
    ("simulate", "dry-run"),
    ("start", "run"),
    ("status", "missions"),
    ("test", "dry-run"),
    ("tutorial", "init"),
    ("validate", "check"),
    ("verify", "check"),
];

/// Names that other programs use for options, with the corresponding option of this program.
const OPTIONS: [(&str, &str); 6] = [
    ("--robots", "--only"),
    ("--robot", "--only"),
    ("--verbose", "--log info"),
    ("-v", "--log info"),
    ("--json", "--format json"),
    ("--start-at", "--at"),
];

/// Arguments that may be missing, with a suggestion for each.
const MISSING: [(&str, &str); 4] = [
    ("<SCENARIO>", "`downbeat init first-show` creates an example scenario: `first-show/show.yaml`"),
    ("--driver <DRIVER>", "to get started, use `--driver sim`, which drives no hardware"),
    (
        "--init <FILE>",
        "the file describes the robot; `downbeat init first-show` creates an example: `first-show/robots/arm.yaml`",
    ),
    ("--output <DIR>", "specify a folder for the files, for example `--output out`"),
];

/// Pairs of options that exclude each other, with a suggestion for each pair.
const CONFLICTS: [(&str, &str); 3] = [
    (
        "--no-journal",
        "leave out `--no-journal`: other terminals need the journal to find a mission in the background",
    ),
    (
        "--lead <TIME>",
        "`--at` sets the time of the start, `--lead` the time until the start: use only one of them",
    ),
    (
        "--from <NAME>",
        "`--act` plays one act, `--from` plays an act and all acts after it: use only one of them",
    ),
];

/// Adds tips to clap's error for arguments that cannot be parsed.
pub(super) fn advise(error: &mut clap::Error, args: &[String]) {
    let tips = match error.kind() {
        ErrorKind::UnknownArgument => of_argument(&text(error, ContextKind::InvalidArg), args),
        ErrorKind::InvalidSubcommand => of_command(error),
        ErrorKind::MissingRequiredArgument => of_missing(error),
        ErrorKind::ArgumentConflict => of_conflict(error),
        ErrorKind::InvalidValue if text(error, ContextKind::InvalidValue).is_empty() => of_no_value(error),
        ErrorKind::InvalidValue => {
            let wrong = text(error, ContextKind::InvalidValue);
            if !is_near(&wrong, error.get(ContextKind::SuggestedValue)) {
                let _misleading = error.remove(ContextKind::SuggestedValue);
            }
            return;
        }
        _ => return,
    };
    let unhelpful = error.kind() == ErrorKind::UnknownArgument;
    if !tips.is_empty() || unhelpful {
        let tips = tips.into_iter().map(StyledStr::from).collect();
        let _of_clap = error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
    }
}

fn text(error: &clap::Error, kind: ContextKind) -> String {
    match error.get(kind) {
        Some(ContextValue::String(text)) => text.clone(),
        Some(ContextValue::Strings(texts)) => texts.join(" "),
        _ => String::new(),
    }
}

fn of_argument(wrong: &str, args: &[String]) -> Vec<String> {
    let name = wrong.split('=').next().unwrap_or(wrong);
    if let Some((_, right)) = OPTIONS.iter().find(|(other, _)| *other == name) {
        return vec![format!("the option is called `{right}`")];
    }
    if !name.starts_with('-') {
        return vec![of_positional(wrong, args)];
    }
    let cli = Cli::command();
    let typed = args.iter().find(|arg| arg.len() > 2 && arg.starts_with(name) && !arg.starts_with("--"));
    if let Some(typed) = typed {
        return vec![format!("long options start with two dashes: `-{typed}`")];
    }
    let Some(long) = name.strip_prefix("--") else { return Vec::new() };
    let takes = |command: &&Command| command.get_arguments().any(|arg| arg.get_long() == Some(long));
    let takers: Vec<String> = cli
        .get_subcommands()
        .filter(takes)
        .map(|command| format!("`downbeat {}`", command.get_name()))
        .collect();
    if takers.is_empty() {
        Vec::new()
    } else {
        vec![format!("`{name}` is an option of {}", takers.join(", "))]
    }
}

fn of_positional(wrong: &str, args: &[String]) -> String {
    let at = args.iter().position(|arg| arg == wrong).unwrap_or(0);
    match at.checked_sub(1).map(|before| &args[before]).filter(|before| before.ends_with(',')) {
        Some(before) => format!("write the list without spaces: `{before}{wrong}`"),
        None => "this command takes no more arguments; run it again for another file".to_owned(),
    }
}

fn of_command(error: &mut clap::Error) -> Vec<String> {
    let wrong = text(error, ContextKind::InvalidSubcommand);
    if let Some((_, right)) = COMMANDS.iter().find(|(other, _)| *other == wrong) {
        let _misleading = error.remove(ContextKind::SuggestedSubcommand);
        return vec![format!("the command is `downbeat {right}`")];
    }
    if Path::new(&wrong).extension().is_some() || Path::new(&wrong).exists() {
        let _misleading = error.remove(ContextKind::SuggestedSubcommand);
        return vec![format!("add a command: `downbeat check {wrong}` or `downbeat run {wrong}`")];
    }
    if is_near(&wrong, error.get(ContextKind::SuggestedSubcommand)) {
        return Vec::new();
    }
    let _misleading = error.remove(ContextKind::SuggestedSubcommand);
    let cli = Cli::command();
    let near = did_you_mean(&wrong, cli.get_subcommands().map(Command::get_name));
    vec![near.unwrap_or_else(|| "`downbeat --help` lists the commands".to_owned())]
}

/// Whether clap's suggestion is similar to the user's text.
fn is_near(wrong: &str, suggested: Option<&ContextValue>) -> bool {
    let near = |right: &String| did_you_mean(wrong, [right.as_str()]).is_some();
    match suggested {
        Some(ContextValue::String(right)) => near(right),
        Some(ContextValue::Strings(rights)) => rights.iter().any(near),
        _ => false,
    }
}

fn of_no_value(error: &clap::Error) -> Vec<String> {
    let option = text(error, ContextKind::InvalidArg).replace(['<', '>'], "");
    vec![format!("add a value after the option: `{option}`")]
}

fn of_missing(error: &clap::Error) -> Vec<String> {
    let missing = text(error, ContextKind::InvalidArg);
    let known = MISSING.iter().filter(|(name, _)| missing.contains(name));
    known.map(|(_, tip)| (*tip).to_owned()).collect()
}

fn of_conflict(error: &clap::Error) -> Vec<String> {
    let both = text(error, ContextKind::InvalidArg) + " " + &text(error, ContextKind::PriorArg);
    let known = CONFLICTS.iter().filter(|(name, _)| both.contains(name));
    known.map(|(_, tip)| (*tip).to_owned()).collect()
}
