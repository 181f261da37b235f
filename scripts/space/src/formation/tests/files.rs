//! Tests of formations from files: clouds of points, and surfaces.

use proptest::prelude::*;

use super::super::cloud::{Cloud, read};
use super::super::crowd::nearest_pair;
use super::super::{Formation, Placing, Point, Shape};

const TRIANGLES: [[Point; 3]; 2] = [
    [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0]],
    [[0.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]],
];

#[track_caller]
fn points(name: &str, bytes: &[u8], expected: &[Point]) {
    assert_eq!(read(name, bytes), Ok(Cloud::Points(expected.to_vec())));
}

#[track_caller]
fn refused(name: &str, bytes: &[u8], message: &str) {
    let found = read(name, bytes).map_err(|unfit| unfit.message).expect_err("it was read");
    assert!(found.contains(message), "{found}");
}

/// Returns a square as a binary STL file whose header begins like that of a text file.
fn binary_stl() -> Vec<u8> {
    let mut bytes = b"solid but binary".to_vec();
    bytes.resize(80, 0);
    bytes.extend(2u32.to_le_bytes());
    for triangle in TRIANGLES {
        let corners = [[0.0; 3]].into_iter().chain(triangle).flatten();
        #[expect(clippy::cast_possible_truncation, reason = "small whole numbers")]
        bytes.extend(corners.flat_map(|part: f64| (part as f32).to_le_bytes()));
        bytes.extend([0, 0]);
    }
    bytes
}

fn binary_ply() -> Vec<u8> {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty double y\n\
        property short z\nproperty uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        .to_vec();
    for (x, y, z) in [(1f32, 2f64, 3i16), (-1.5, 0.25, -7)] {
        bytes.extend(x.to_le_bytes());
        bytes.extend(y.to_le_bytes());
        bytes.extend(z.to_le_bytes());
        bytes.push(255);
    }
    bytes
}

const TEXT_PLY: &str = "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 2\nproperty float x\nproperty float y\n\
    property float z\nproperty uchar red\nend_header\n1 2 3 255\n-1.5 0.25 -7 0\n";

#[test]
fn tables_are_read_with_and_without_a_header() {
    let expected = [[1.0, 2.0, 3.0], [-1.0, 0.5, 0.0]];
    points("a.csv", b"1,2,3\n-1,0.5,0\n", &expected);
    points("a.csv", b"\xef\xbb\xbf# by hand\nx [m],y [m],z [m]\n1,2,3\n-1,0.5,0", &expected);
    points("A.CSV", b"name;Z;Y;X\nd1;3;2;1\nd2;0;0.5;-1", &expected);
    refused("a.csv", b"x,y,z\n1,2,3\n4,5\n", "line 3 does not have three numbers");
    refused("a.csv", b"1,2,nan\n", "not a finite number");
    refused("a.csv", b"x,y,z\n", "no rows");
    refused("a.csv", b"", "no rows");
    refused("a.csv", b"\xff,2,3", "UTF-8");
}

#[test]
fn drawing_with_a_huge_arc_is_refused_quickly() {
    let path =
        |data: &str| format!("<svg xmlns='http://www.w3.org/2000/svg'><path d='{data}' stroke='red'/></svg>");
    let huge = format!("M0 0 A2 2 0 1 0 {} 5 Z", "9".repeat(44));
    for data in
        [huge.as_str(), "M0 0A1e40 2 0 1 0-5-5", "M.5.5A2 2 0 1 0 .5.5e40,5", "M0,0a2,2,0,1,0-1E+30,5"]
    {
        let told = crate::formation::svg::read(path(data).as_bytes()).unwrap_err();
        assert!(
            told.message.starts_with("a path or shape of the drawing contains a number that is too large"),
            "{data}: {}",
            told.message
        );
    }
    let far = "4".repeat(38);
    for shape in [
        format!("<circle cx='5' cy='2' r='{far}'/>"),
        format!("<ellipse rx='3' ry='1{far}'/>"),
        format!("<rect width='9' height='9{far}' rx='1'/>"),
        format!("<polygon points='0,0 1,{far} 2,2'/>"),
    ] {
        let drawing = format!("<svg xmlns='http://www.w3.org/2000/svg'>{shape}</svg>");
        let told = crate::formation::svg::read(drawing.as_bytes()).unwrap_err();
        assert!(told.message.contains("contains a number that is too large"), "{shape}: {}", told.message);
    }
    let entity = "<!DOCTYPE svg [<!ENTITY far '1e40'>]><svg xmlns='http://www.w3.org/2000/svg'><path d='M0 0 A2 2 0 1 0 &far; 5' stroke='red'/></svg>";
    assert!(crate::formation::svg::read(entity.as_bytes()).is_err());
    for data in ["M0 0A2 2 0 1 0 5e-40 5", "M1.5.5-2e3-4", "M 0 0 l 123456789 1"] {
        assert!(crate::formation::svg::read(path(data).as_bytes()).is_ok(), "{data}");
    }
}

#[test]
fn vertices_are_read_from_text_and_binary_files() {
    let expected = [[1.0, 2.0, 3.0], [-1.5, 0.25, -7.0]];
    points("a.ply", TEXT_PLY.as_bytes(), &expected);
    points("a.ply", &binary_ply(), &expected);
    refused("a.ply", &binary_ply()[..200], "");
    refused(
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 999999999\nproperty float x\nend_header\n",
        "too short",
    );
    let endless = "ply\nformat binary_little_endian 1.0\nelement a 99\nend_header\n";
    refused("a.ply", endless.as_bytes(), "");
    let flat = TEXT_PLY.replace("property float z", "property float w");
    refused("a.ply", flat.as_bytes(), "the `vertex` element has no property `z`");
    refused("a.ply", b"ply\nformat ascii 1.0\n", "missing end of the PLY header");
}

#[test]
fn triangles_are_read_from_text_and_binary_files() {
    let mut text = "solid square\n".to_owned();
    for triangle in TRIANGLES {
        let corners = triangle.map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).concat();
        text.push_str(&format!("facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"));
    }
    text.push_str("endsolid square\n");
    let square = Ok(Cloud::Surface(TRIANGLES.to_vec()));
    assert_eq!(read("a.stl", text.as_bytes()), square);
    assert_eq!(read("a.stl", &binary_stl()), square);
    let short = binary_stl().len() - 1;
    refused("a.stl", &binary_stl()[..short], "");
    refused("a.stl", b"solid nothing\nendsolid nothing\n", "all triangles in the file have an area of 0");
}

#[test]
fn file_that_does_not_match_its_extension_is_refused() {
    refused("a.ply", b"\x89PNG\r\n", "a picture");
    refused("a.ply", &binary_stl(), "not a PLY");
    refused("a.stl", TEXT_PLY.as_bytes(), "not an STL");
    refused("a.obj", b"v 1 2 3", "unknown file name extension");
}

#[test]
fn surfaces_and_dense_clouds_are_thinned_evenly() {
    let surface = Shape::Surface(TRIANGLES.into());
    let grid = (0..50).flat_map(|x| (0..50).map(move |y| [f64::from(x) * 0.08, f64::from(y) * 0.08, 0.0]));
    let cloud = Shape::Cloud(grid.collect::<Vec<Point>>().into());
    for shape in [surface, cloud] {
        let formation = Formation { shape, placing: Placing::default() };
        assert!(formation.places(0).unwrap().is_empty());
        assert_eq!(formation.places(1).unwrap().len(), 1);
        for count in [4, 9, 100] {
            let places = formation.places(count).unwrap();
            assert_eq!(places.len(), count);
            let nearest = nearest_pair(&places).unwrap().distance;
            // The distance between neighbouring points of a square grid.
            let even = 4.0 / (f64::from(u32::try_from(count).unwrap()).sqrt() - 1.0);
            assert!(nearest > 0.6 * even, "{count}: {nearest} of {even}");
        }
        assert_eq!(formation.places(9).unwrap(), formation.places(9).unwrap(), "always the same");
    }
    let few = Formation { shape: Shape::Cloud([[1.0; 3]].into()), placing: Placing::default() };
    assert_eq!(few.places(7).unwrap(), [[1.0; 3]]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn arbitrary_bytes_are_read_as_a_cloud_or_refused(
        format in 0u8..3,
        from in 0usize..3,
        at in 0usize..400,
        change in any::<[u8; 4]>(),
        keep in 0usize..400,
    ) {
        let mut bytes = [binary_stl(), binary_ply(), TEXT_PLY.into()][from].clone();
        for (index, byte) in change.into_iter().enumerate() {
            let length = bytes.len();
            bytes[(at + index) % length] = byte;
        }
        bytes.truncate(keep.max(4));
        super::super::tried::tried(format, &bytes);
    }
}
