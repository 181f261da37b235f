//! Reads the triangles of an STL file, as text or binary.

use std::borrow::Cow;
use std::io::Cursor;

use super::{Format, ITEMS_MAX};
use crate::formation::Unfit;
use crate::formation::spread::{Triangle, area};

/// Length in bytes of a binary file's header, including the number of triangles.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

pub(super) fn read(bytes: &[u8]) -> Result<Vec<Triangle>, Unfit> {
    let unfit = |message: String| Format::Stl.unfit(message);
    let failed = |error: std::io::Error| unfit(downbeat_yaml::shown::shortened(&error.to_string()));
    let mut bytes = Cow::Borrowed(bytes);
    match is_binary(&bytes) {
        // Some binary files begin with the word `solid`, as text files do.
        true => bytes.to_mut()[0] = 0,
        false if bytes.starts_with(b"solid") => {}
        false => return Err(unfit("this is not an STL file, or it is incomplete".to_owned())),
    }
    let mut cursor = Cursor::new(&*bytes);
    let triangles = stl_io::create_stl_reader(&mut cursor).map_err(failed)?;
    let mut surface: Vec<Triangle> = Vec::new();
    for triangle in triangles {
        let corners = triangle.map_err(failed)?.vertices.map(|corner| corner.0.map(f64::from));
        surface.push(corners);
        if surface.len() > ITEMS_MAX {
            return Err(unfit(format!("the file has more than {ITEMS_MAX} triangles")));
        }
    }
    if surface.iter().any(|triangle| area(triangle) > 0.0) {
        Ok(surface)
    } else {
        Err(unfit("all triangles in the file have an area of 0".to_owned()))
    }
}

/// Whether the file is binary: its length then follows from the number of triangles in its header.
fn is_binary(bytes: &[u8]) -> bool {
    let count = bytes.get(80..HEADER).and_then(|count| count.try_into().ok()).map(u32::from_le_bytes);
    let length = |count: u32| HEADER + TRIANGLE * usize::try_from(count).unwrap_or(usize::MAX / 100);
    count.is_some_and(|count| bytes.len() == length(count))
}
