//! Tests that the modules of a crate are layers: no module imports another that imports it, directly or through others.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use stage::session::root;

/// Returns the other modules that each top-level module of a crate imports by a path that begins with `crate::`. Tests and the crate root
/// are left out, because the root may import anything.
fn imports(source: &Path) -> BTreeMap<String, BTreeSet<String>> {
    let mut imports = BTreeMap::new();
    collect(source, None, &mut imports);
    imports.remove("lib");
    imports.remove("main");
    imports
}

fn collect(folder: &Path, module: Option<&str>, imports: &mut BTreeMap<String, BTreeSet<String>>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if name == "tests" || name.ends_with("_tests") {
            continue;
        }
        let module = module.unwrap_or(&name);
        if path.is_dir() {
            collect(&path, Some(module), imports);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = std::fs::read_to_string(&path).unwrap();
            let found = imports.entry(module.to_owned()).or_default();
            found.extend(imported(&text).into_iter().filter(|imported| imported != module));
        }
    }
}

/// Returns the names of the modules after `crate::` in a file, except in its tests.
fn imported(text: &str) -> BTreeSet<String> {
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let code: Vec<_> = code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect();
    let first = |path: &str| {
        let end = path.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(path.len());
        path[..end].to_owned()
    };
    code.join("\n").split("crate::").skip(1).map(first).filter(|name| !name.is_empty()).collect()
}

/// Repeatedly removes modules that import no remaining module. The remaining modules import each other in cycles.
fn circles(mut imports: BTreeMap<String, BTreeSet<String>>) -> BTreeMap<String, BTreeSet<String>> {
    loop {
        let names: BTreeSet<_> = imports.keys().cloned().collect();
        imports.values_mut().for_each(|imported| imported.retain(|name| names.contains(name)));
        let before = imports.len();
        imports.retain(|_, imported| !imported.is_empty());
        if imports.len() == before {
            return imports;
        }
    }
}

#[test]
fn module_imports_have_no_cycles() {
    for source in [
        "protocol/src",
        "robot/realtime/src",
        "robot/sealed/src",
        "robot/src",
        "robot/invariants/src",
        "scripts/yaml/src",
        "scripts/motion/src",
        "scripts/space/src",
        "scripts/reader/src",
        "scripts/import/src",
        "scripts/fleet/src",
        "scripts/plan/src",
        "scripts/export/src",
        "scripts/src",
        "scripts/lsp/src",
        "scheduler/mission/src",
        "scheduler/runtime/src",
        "scheduler/rehearsal/src",
        "scheduler/show/src",
        "scheduler/history/src",
        "scheduler/conformance/src",
        "scheduler/simulation/src",
        "scheduler/src",
    ] {
        let imports = imports(&root().join(source));
        assert!(imports.len() > 2, "{source} has only {} modules", imports.len());
        let circles = circles(imports);
        assert!(circles.is_empty(), "modules of {source} in circles, with their imports: {circles:#?}");
    }
}

#[test]
fn cycle_through_three_modules_is_found() {
    let imports =
        [("a", "use crate::b::B;"), ("b", "x: crate::c::C"), ("c", "use crate::a;"), ("d", "use crate::a;")];
    let of = |(name, text): (&str, &str)| (name.to_owned(), imported(text));
    assert_eq!(circles(imports.into_iter().map(of).collect()).len(), 4, "`d` leads into the circle");
    let imports = [
        ("a", "use crate::b::B; // crate::c"),
        ("b", "use crate::c;"),
        ("c", "#[cfg(test)]\nmod tests { use crate::a; }"),
    ];
    assert_eq!(circles(imports.into_iter().map(of).collect()), BTreeMap::new());
}
