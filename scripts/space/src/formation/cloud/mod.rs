//! Files with points or a surface: PLY, STL and CSV, told apart by the end of the name.

mod csv;
mod ply;
mod stl;

use std::path::Path;

use super::spread::Triangle;
use super::{Point, Unfit};
use downbeat_yaml::formats;

/// Most points or triangles of a file.
const ITEMS_MAX: usize = 1_000_000;
/// Furthest coordinate in a file, in its unit: it may be in millimetres, or on the globe.
const FURTHEST: f64 = 1e12;

/// What a file holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Cloud {
    /// Points.
    Points(Vec<Point>),
    /// The triangles of a surface.
    Surface(Vec<Triangle>),
}

/// The formats, by the ends of their names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Stl,
    Csv,
}

const FORMATS: [(&str, Format); 3] = [("ply", Format::Ply), ("stl", Format::Stl), ("csv", Format::Csv)];

/// Reads a file by its name and its bytes. The points are finite.
///
/// # Errors
/// It is of no known format, not what its name says, damaged, empty or too large.
pub fn read(name: &str, bytes: &[u8]) -> Result<Cloud, Unfit> {
    let end = Path::new(name).extension().and_then(|end| end.to_str()).unwrap_or("").to_ascii_lowercase();
    let Some((_, format)) = FORMATS.iter().find(|(known, _)| *known == end) else {
        let message = "the name does not say what the file is".to_owned();
        return Err(Unfit { message, expected: "a file that ends with .ply, .stl or .csv" });
    };
    if let Some(what) = formats::binary(bytes) {
        let message = format!("this is {what}, not what its name says");
        return Err(Unfit { message, expected: format.expected() });
    }
    let cloud = match format {
        Format::Ply => Cloud::Points(ply::read(bytes)?),
        Format::Stl => Cloud::Surface(stl::read(bytes)?),
        Format::Csv => Cloud::Points(csv::read(bytes)?),
    };
    let near = |point: &Point| point.iter().all(|part| part.abs() <= FURTHEST);
    let sound = match &cloud {
        Cloud::Points(points) => points.iter().all(near),
        Cloud::Surface(surface) => surface.iter().flatten().all(near),
    };
    if sound {
        Ok(cloud)
    } else {
        Err(format.unfit("a coordinate is not a finite number, or far too large".to_owned()))
    }
}

impl Format {
    const fn expected(self) -> &'static str {
        match self {
            Self::Ply => "a PLY file with an element `vertex` that has `x`, `y` and `z`, at most 1000000",
            Self::Stl => "an STL file with 1 to 1000000 triangles",
            Self::Csv => "a table with three columns of numbers, x, y and z",
        }
    }

    fn unfit(self, message: String) -> Unfit {
        Unfit { message, expected: self.expected() }
    }
}
