//! JSON Schemas (2020-12) of the files that users write, for editors and for programs that generate such files.

pub use maps::all_maps;

/// A kind of file that a schema describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Schema {
    /// A scenario.
    Scenario,
    /// A fleet file.
    Fleet,
    /// A world file.
    World,
}

/// Returns the schema as JSON text.
#[must_use]
pub const fn schema(of: Schema) -> &'static str {
    match of {
        Schema::Scenario => include_str!("schema/scenario.json"),
        Schema::Fleet => include_str!("schema/fleet.json"),
        Schema::World => include_str!("schema/world.json"),
    }
}

#[cfg(test)]
mod generated;
mod maps;
#[cfg(test)]
mod tests;
