//! Reads the vertices of a PLY file, as text or binary. Ignores faces.

use std::io::Cursor;

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Encoding, Property, PropertyAccess, PropertyAccessResult};

use super::{Format, ITEMS_MAX};
use crate::formation::{Point, Unfit};

/// Maximum length of the header in bytes; most headers are below a kilobyte.
const HEADER_MAX: usize = 65_536;

/// A vertex of the file; its properties other than x, y and z are ignored.
#[derive(Clone, Copy, Debug)]
struct Vertex(Point);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self([f64::NAN; 3])
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let value = match property {
            Property::Float(value) => f64::from(value),
            Property::Double(value) => value,
            Property::Char(value) => f64::from(value),
            Property::UChar(value) => f64::from(value),
            Property::Short(value) => f64::from(value),
            Property::UShort(value) => f64::from(value),
            Property::Int(value) => f64::from(value),
            Property::UInt(value) => f64::from(value),
            _ => return PropertyAccessResult::Ignored,
        };
        match ["x", "y", "z"].iter().position(|axis| *axis == name) {
            Some(axis) => self.0[axis] = value,
            None => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

pub(super) fn read(bytes: &[u8]) -> Result<Vec<Point>, Unfit> {
    let unfit = |message: String| Format::Ply.unfit(message);
    if !bytes.starts_with(b"ply") {
        return Err(unfit("this is not a PLY file".to_owned()));
    }
    let marker = b"end_header";
    let header_ends = bytes.windows(marker.len()).take(HEADER_MAX).any(|window| window == marker);
    if !header_ends {
        return Err(unfit("missing end of the PLY header".to_owned()));
    }
    let failed = |error: ply_rs_bw::parser::ParseError| unfit(shown(&error.to_string()));
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = parser.read_header(&mut reader).map_err(failed)?;
    for (name, element) in &header.elements {
        // Every element takes at least one byte, so the size of the file bounds the work.
        let is_bounded = header.encoding == Encoding::Ascii || !element.properties.is_empty();
        if element.count > bytes.len() || !is_bounded {
            return Err(unfit(format!(
                "the file is too short for its {} `{}` elements",
                element.count,
                shown(name)
            )));
        }
        if name != "vertex" {
            let _passed_over =
                parser.read_payload_for_element(&mut reader, element, &header).map_err(failed)?;
            continue;
        }
        if !(1..=ITEMS_MAX).contains(&element.count) {
            return Err(unfit(format!("the file has {} vertices", element.count)));
        }
        let lacks = |axis: &&str| !element.properties.iter().any(|(known, _)| known.as_str() == *axis);
        if let Some(axis) = ["x", "y", "z"].into_iter().find(lacks) {
            return Err(unfit(format!("the `vertex` element has no property `{axis}`")));
        }
        let vertices = parser.read_payload_for_element(&mut reader, element, &header).map_err(failed)?;
        return Ok(vertices.into_iter().map(|Vertex(point)| point).collect());
    }
    Err(unfit("the file has no `vertex` element".to_owned()))
}

/// Returns the first line of a message from the library, shortened.
fn shown(text: &str) -> String {
    downbeat_yaml::shown::shortened(text.lines().next().unwrap_or(""))
}
