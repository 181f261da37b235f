//! Reads files with points or a surface: PLY, STL and CSV, distinguished by their extension.

mod csv;
mod ply;
mod stl;

use std::path::Path;

use super::spread::Triangle;
use super::{Point, Unfit};
use downbeat_yaml::formats;

/// Maximum number of points or triangles in a file.
const ITEMS_MAX: usize = 1_000_000;
/// Largest accepted coordinate in a file, in the file's unit. The limit permits millimetres, and coordinates that refer to the globe.
const FURTHEST: f64 = 1e12;

/// The points or the surface in a file.
#[derive(Clone, Debug, PartialEq)]
pub enum Cloud {
    /// The points in the file.
    Points(Vec<Point>),
    /// The surface in the file, as triangles.
    Surface(Vec<Triangle>),
}

/// The file formats, distinguished by the extension of the name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Stl,
    Csv,
}

const FORMATS: [(&str, Format); 3] = [("ply", Format::Ply), ("stl", Format::Stl), ("csv", Format::Csv)];

/// Reads the bytes of a file; its name determines the format. All returned points are finite.
///
/// # Errors
/// Returns the fault if the format is unknown or does not match the name, or if the file is damaged, empty or too large.
pub fn read(name: &str, bytes: &[u8]) -> Result<Cloud, Unfit> {
    let end = Path::new(name).extension().and_then(|end| end.to_str()).unwrap_or("").to_ascii_lowercase();
    let Some((_, format)) = FORMATS.iter().find(|(known, _)| *known == end) else {
        let message = "unknown file name extension".to_owned();
        return Err(Unfit { message, expected: "a file name that ends in .ply, .stl or .csv" });
    };
    if let Some(what) = formats::binary(bytes) {
        let message = format!("this is {what}, which does not match the file name extension");
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
        Err(format.unfit("a coordinate is not a finite number, or is too large".to_owned()))
    }
}

impl Format {
    const fn expected(self) -> &'static str {
        match self {
            Self::Ply => "a PLY file with 1 to 1000000 `vertex` elements that have `x`, `y` and `z`",
            Self::Stl => "an STL file with 1 to 1000000 triangles",
            Self::Csv => "a table with three columns of numbers, x, y and z",
        }
    }

    fn unfit(self, message: String) -> Unfit {
        Unfit { message, expected: self.expected() }
    }
}
