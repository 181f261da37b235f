//! A robot's description: an initialization block, or the dictionary of devices with which Thrift robots describe themselves.

mod dictionary;
mod faults;
mod keys;
mod supplement;

use std::path::Path;

use urrcp::InitializationBlock;

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, Finding};
use downbeat_yaml::identify::{self, Document};
use downbeat_yaml::locate::locate;
use downbeat_yaml::node::{self, Node};
use downbeat_yaml::source::Source;
use downbeat_yaml::syntax::{conceal, has_key};

pub(crate) use self::supplement::DeviceKeys;
pub use self::supplement::{Supplement, read as read_supplements};

/// The expected form of a robot's description, for error messages.
const EXPECTED: &str = "an initialization block: `id`, `api_version` and `devices`, each device with its `available_control_types`";

/// Reads a robot's description from a YAML or JSON file.
///
/// # Errors
/// Returns findings if the file cannot be read or does not describe a robot.
pub fn read_init(path: &Path) -> Result<InitializationBlock, Vec<Finding>> {
    init_of(&Source::read(path).map_err(|finding| vec![finding])?)
}

/// Reads a robot's description from a text in YAML or JSON.
///
/// # Errors
/// Returns findings if the text does not describe a robot.
pub fn init_of(source: &Source) -> Result<InitializationBlock, Vec<Finding>> {
    Init::read(source.clone())?.block(&Supplement::none())
}

/// Formats a description as the text of an init file in YAML. [`init_of`] reads it back.
#[must_use]
pub fn init_text(block: &InitializationBlock) -> String {
    // YAML can represent all contents: maps with text keys, numbers and lists.
    serde_yaml::to_string(block).unwrap_or_default()
}

/// A robot's description as read from a file.
#[derive(Clone, Debug)]
pub enum Init {
    /// A complete description, and warnings about it.
    Block(Box<InitializationBlock>, Vec<Finding>),
    /// The description of a Thrift robot: a dictionary of devices, which may be incomplete.
    Dictionary(Source, Node),
}

impl Init {
    /// Reads a robot's description: an initialization block, or a dictionary of devices.
    pub fn read(source: Source) -> Result<Self, Vec<Finding>> {
        let concealed = |finding| vec![conceal(finding, &source, keys::of_block())];
        if let Some(finding) = node::too_large(&source) {
            return Err(concealed(finding));
        }
        let wrong = match block_of(&source) {
            Ok(block) => return Ok(Self::Block(Box::new(block), keys::ignored(&source))),
            Err(finding) => finding,
        };
        let document = node::parse(&source);
        if let Some(mistaken) =
            document.as_ref().ok().and_then(|document| identify::mistaken(&source, document, Document::Robot))
        {
            return Err(vec![mistaken]);
        }
        match document {
            // The other findings may quote values before the place of the mistake.
            Err(finding) if !has_key(&source.text, keys::of_block()) => {
                Err(concealed(Finding { code: Code::InitializationBlock, ..finding }))
            }
            Ok(document) if dictionary::is_one(&document) && !dictionary::is_block(&document) => {
                Ok(Self::Dictionary(source, document))
            }
            Ok(document) if identify::is_foreign(&document, keys::of_block()) => {
                Err(identify::mistaken_by_keys(&source, &document, Document::Robot, keys::of_block())
                    .into_iter()
                    .collect())
            }
            _ => {
                let found = faults::of(&source);
                Err(if found.is_empty() { vec![wrong] } else { found })
            }
        }
    }

    /// Returns the complete initialization block. For each device id, `supplements` contains the values that a dictionary lacks.
    pub fn block(&self, supplements: &[(String, Supplement)]) -> Result<InitializationBlock, Vec<Finding>> {
        match self {
            Self::Block(block, _) => Ok(block.as_ref().clone()),
            Self::Dictionary(source, document) => {
                let mut findings = Reader::default();
                let block = dictionary::block(&mut findings, &At::document(document, 0), supplements);
                let findings = locate(std::slice::from_ref(source), findings.finish());
                block.filter(|_| findings.is_empty()).ok_or(findings)
            }
        }
    }

    /// Returns the ids of the devices in the description.
    pub fn devices(&self) -> Vec<&str> {
        match self {
            Self::Block(block, _) => block.devices.iter().map(|device| device.id.as_str()).collect(),
            Self::Dictionary(_, document) => dictionary::device_ids(document),
        }
    }
}

fn block_of(source: &Source) -> Result<InitializationBlock, Finding> {
    serde_yaml::from_str(&source.text).map_err(|error| {
        let mut finding = downbeat_yaml::syntax::syntax_finding(source, &error);
        finding.code = Code::InitializationBlock;
        finding.expected = EXPECTED.into();
        finding
    })
}

#[cfg(test)]
mod tests;
