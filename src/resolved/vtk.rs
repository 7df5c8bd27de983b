//! VTK's XML files: images (.vti), rectilinear (.vtr) and unstructured grids (.vtu) of equal cells,
//! their parallel forms (.pvti, .pvtr, .pvtu), particles (.vtp), and series (.pvd).
//!
//! Read: ascii, inline base64 and appended raw or base64 data, plain or compressed by zlib, LZ4 or
//! LZMA, either byte order and size of header. Cells of an unstructured grid may come in any order.

use super::{Array, Columns, Lattice, POINT_DATA, Piece, ResolvedError, decode};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use roxmltree::{Document, Node};
use std::borrow::Cow;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Cell types of VTK that are boxes, and their number of corners: pixel, quadrilateral, voxel,
/// hexahedron.
const BOXES: [(u8, usize); 4] = [(8, 4), (9, 4), (11, 8), (12, 8)];

/// Largest block that a compressed array is believed to have \[bytes\].
const LARGEST_BLOCK: u64 = 1 << 32;

/// A VTK XML file whose data have not been decoded yet.
struct File {
    path: PathBuf,
    xml: String,
    appended: Option<Appended>,
}

struct Appended {
    bytes: Vec<u8>,
    raw: bool,
}

/// How the data of a file are encoded.
#[derive(Clone, Copy)]
struct Encoding<'a> {
    big_endian: bool,
    /// Bytes of a number in a header.
    header: usize,
    compressor: Option<Compressor>,
    appended: Option<&'a Appended>,
}

#[derive(Clone, Copy)]
enum Compressor {
    Zlib,
    Lz4,
    Lzma,
}

impl File {
    fn open(path: &Path) -> Result<Self, ResolvedError> {
        let bytes = fs::read(path).map_err(ResolvedError::read(path))?;
        let refuse = |why: &str| ResolvedError::format(path, why);
        const TAG: &[u8] = b"<AppendedData";
        let at = bytes.windows(TAG.len()).position(|window| window == TAG);
        let (xml, appended) = match at {
            None => (bytes, None),
            Some(at) => {
                // What is appended may be bytes that no XML can hold.
                let after = |from: usize, wanted: u8| {
                    let found = bytes[from..].iter().position(|byte| *byte == wanted);
                    found.map(|found| from + found + 1)
                };
                let tag_end = after(at, b'>').ok_or_else(|| refuse("it ends within a tag"))?;
                let begin = after(tag_end, b'_');
                let begin = begin.ok_or_else(|| refuse("its appended data do not begin with _"))?;
                let tag = String::from_utf8_lossy(&bytes[at..tag_end]);
                let raw = !tag.contains("base64");
                let mut xml = bytes[..at].to_vec();
                xml.extend(b"</VTKFile>");
                (xml, Some(Appended { bytes: bytes[begin..].to_vec(), raw }))
            }
        };
        let xml = String::from_utf8(xml).map_err(|_| {
            refuse("it is not text: an XML file of VTK is expected, not the legacy format (.vtk)")
        })?;
        Ok(Self { path: path.to_owned(), xml, appended })
    }

    fn parse(&self) -> Result<Document<'_>, ResolvedError> {
        let document = Document::parse(&self.xml);
        let document =
            document.map_err(|error| ResolvedError::format(&self.path, format!("XML: {error}")))?;
        match document.root_element().tag_name().name() {
            "VTKFile" => Ok(document),
            other => {
                let why = format!("it is a file of <{other}> and one of <VTKFile> is expected");
                Err(ResolvedError::format(&self.path, why))
            }
        }
    }

    fn encoding(&self, root: Node) -> Result<Encoding<'_>, ResolvedError> {
        let compressor = match root.attribute("compressor") {
            None | Some("") => None,
            Some("vtkZLibDataCompressor") => Some(Compressor::Zlib),
            Some("vtkLZ4DataCompressor") => Some(Compressor::Lz4),
            Some("vtkLZMADataCompressor") => Some(Compressor::Lzma),
            Some(other) => {
                let why = format!("it is compressed by {other}, and zlib, LZ4 and LZMA are read");
                return Err(ResolvedError::format(&self.path, why));
            }
        };
        Ok(Encoding {
            big_endian: root.attribute("byte_order") == Some("BigEndian"),
            header: if root.attribute("header_type") == Some("UInt64") { 8 } else { 4 },
            compressor,
            appended: self.appended.as_ref(),
        })
    }
}

impl Encoding<'_> {
    /// The values of a DataArray.
    fn values(&self, array: Node) -> Result<Vec<f64>, String> {
        let kind = array.attribute("type").unwrap_or_default();
        let text = || array.text().unwrap_or_default();
        let bytes = match array.attribute("format").unwrap_or("ascii") {
            "ascii" => {
                return text()
                    .split_ascii_whitespace()
                    .map(|word| word.parse().map_err(|_| format!("{word} is not a number")))
                    .collect();
            }
            "binary" => self.decode(text().trim().as_bytes(), false)?,
            "appended" => {
                let appended = self.appended.ok_or("its file has no appended data")?;
                let offset = array.attribute("offset").and_then(|offset| offset.parse().ok());
                let offset: usize = offset.ok_or("it has no offset into the appended data")?;
                let data = appended.bytes.get(offset..).ok_or("its data are not in the file")?;
                self.decode(data, appended.raw)?
            }
            other => return Err(format!("its format {other} is unknown")),
        };
        self.numbers(kind, &bytes)
    }

    fn numbers(&self, kind: &str, bytes: &[u8]) -> Result<Vec<f64>, String> {
        let code = match kind {
            "Float64" => "f8",
            "Float32" => "f4",
            "Int8" => "i1",
            "UInt8" => "u1",
            "Int16" => "i2",
            "UInt16" => "u2",
            "Int32" => "i4",
            "UInt32" => "u4",
            "Int64" => "i8",
            "UInt64" => "u8",
            other => other,
        };
        decode(code, self.big_endian, bytes)
            .unwrap_or_else(|| Err(format!("its type {kind} is not a number")))
    }

    fn word(&self, bytes: &[u8]) -> u64 {
        let fold = |word: u64, byte: &u8| word << 8 | u64::from(*byte);
        match self.big_endian {
            true => bytes.iter().fold(0, fold),
            false => bytes.iter().rev().fold(0, fold),
        }
    }

    /// The bytes of an array whose header stands at the begin of `data`.
    fn decode(&self, data: &[u8], raw: bool) -> Result<Vec<u8>, String> {
        const CUT: &str = "its data end too early: the file is cut short";
        let data: Cow<[u8]> = match raw {
            true => data.into(),
            // Lines may be broken anywhere; what follows belongs to other arrays.
            false => data.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect(),
        };
        // `count` bytes from `at`, and where what follows them begins: in base64 a new group of
        // four characters if the header was encoded on its own.
        let take = |at: usize, count: usize| -> Result<(Cow<[u8]>, usize), String> {
            if raw {
                let end = at.checked_add(count).filter(|end| *end <= data.len()).ok_or(CUT)?;
                return Ok((data[at..end].into(), end));
            }
            let end = count.div_ceil(3).checked_mul(4).and_then(|length| at.checked_add(length));
            let end = end.filter(|end| *end <= data.len()).ok_or(CUT)?;
            let bytes = STANDARD.decode(&data[at..end]).map_err(|error| error.to_string());
            let mut bytes = bytes.map_err(|error| format!("its base64 is damaged: {error}"))?;
            if bytes.len() < count {
                return Err(CUT.into());
            }
            bytes.truncate(count);
            Ok((bytes.into(), end))
        };
        let size = self.header;
        let Some(compressor) = self.compressor else {
            if raw {
                let (head, at) = take(0, size)?;
                return Ok(take(at, length(self.word(&head))?)?.0.into_owned());
            }
            // The header is encoded with the data, or on its own and then padded.
            let chars = size.div_ceil(3) * 4;
            let group = data.get(..chars).ok_or(CUT)?;
            let head = lenient(group)?;
            let count = length(self.word(head.get(..size).ok_or(CUT)?))?;
            if group.ends_with(b"=") {
                return Ok(take(chars, count)?.0.into_owned());
            }
            let (mut bytes, _) = take(0, size + count)?;
            return Ok(bytes.to_mut().split_off(size));
        };
        let (head, _) = take(0, 3 * size)?;
        let word = |head: &[u8], n: usize| self.word(&head[n * size..(n + 1) * size]);
        let [count, block, last] = [0, 1, 2].map(|n| word(&head, n));
        if count == 0 {
            return Ok(Vec::new());
        }
        if block > LARGEST_BLOCK || last > block || count > data.len() as u64 {
            return Err("the header of its compressed data is damaged".into());
        }
        let (head, at) = take(0, (3 + count as usize) * size)?;
        let sizes: Vec<usize> =
            (3..3 + count as usize).map(|n| length(word(&head, n))).collect::<Result<_, _>>()?;
        let total = sizes.iter().try_fold(0usize, |total, size| total.checked_add(*size));
        let (packed, _) = take(at, total.ok_or(CUT)?)?;
        let (mut bytes, mut rest) = (Vec::new(), &packed[..]);
        for (n, size) in sizes.into_iter().enumerate() {
            let (piece, after) = rest.split_at(size);
            rest = after;
            let full = n + 1 < count as usize || last == 0;
            let expected = if full { block } else { last } as usize;
            let unpacked = unpack(compressor, piece, expected)
                .map_err(|error| format!("block {n} of its compressed data is damaged: {error}"))?;
            if unpacked.len() != expected {
                return Err(format!("block {n} of its compressed data has another length"));
            }
            bytes.extend(unpacked);
        }
        Ok(bytes)
    }
}

/// Base64 that may be padded or not.
fn lenient(group: &[u8]) -> Result<Vec<u8>, String> {
    STANDARD.decode(group).map_err(|error| format!("its base64 is damaged: {error}"))
}

fn length(word: u64) -> Result<usize, String> {
    usize::try_from(word).map_err(|_| format!("it would be {word} bytes long"))
}

fn unpack(compressor: Compressor, packed: &[u8], expected: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    // One more byte than is expected shows that there is too much.
    let most = expected as u64 + 1;
    match compressor {
        Compressor::Zlib => {
            let read = ZlibDecoder::new(packed).take(most).read_to_end(&mut bytes);
            read.map_err(|error| error.to_string())?;
        }
        Compressor::Lz4 => {
            bytes = lz4_flex::block::decompress(packed, expected).map_err(|e| e.to_string())?;
        }
        Compressor::Lzma => {
            let reader = lzma_rust2::XzReader::new(packed, true);
            reader.take(most).read_to_end(&mut bytes).map_err(|error| error.to_string())?;
        }
    }
    Ok(bytes)
}

/// The element children of `node` called `name`.
fn children<'a, 'i: 'a>(
    node: Node<'a, 'i>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |child| child.has_tag_name(name))
}

fn child<'a, 'i: 'a>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    children(node, name).next()
}

fn attribute<const N: usize, T: std::str::FromStr>(
    node: Node,
    name: &str,
) -> Result<[T; N], String> {
    let text = node.attribute(name).unwrap_or_default();
    let numbers: Vec<T> =
        text.split_ascii_whitespace().filter_map(|word| word.parse().ok()).collect();
    numbers
        .try_into()
        .map_err(|_| format!("{name} is \"{text}\" and {N} numbers are expected there"))
}

/// The times and files of a series (.pvd).
///
/// # Errors
/// It cannot be read, or is not a series.
pub fn series(path: &Path) -> Result<Vec<(f64, PathBuf)>, ResolvedError> {
    let file = File::open(path)?;
    let document = file.parse()?;
    let collection = child(document.root_element(), "Collection")
        .ok_or_else(|| ResolvedError::format(path, "it holds no <Collection>"))?;
    children(collection, "DataSet")
        .map(|entry| {
            let time = entry.attribute("timestep").and_then(|time| time.trim().parse().ok());
            match (time, entry.attribute("file")) {
                (Some(time), Some(name)) => Ok((time, path.with_file_name(name))),
                _ => Err(ResolvedError::format(path, "a <DataSet> has no timestep or no file")),
            }
        })
        .collect()
}

/// The time that a file gives, if it does.
///
/// # Errors
/// It cannot be read.
pub fn time(path: &Path) -> Result<Option<f64>, ResolvedError> {
    let file = File::open(path)?;
    let document = file.parse()?;
    let root = document.root_element();
    let mut piece = Piece::default();
    read_field_data(&file, root, &file.encoding(root)?, &mut piece)?;
    Ok(piece.time)
}

/// Reads the grid or the particles at `path`; arrays that `wanted` refuses are left out.
///
/// # Errors
/// The file cannot be read or is damaged, or it is not of equal cells that fill a box.
pub fn read(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Piece, ResolvedError> {
    let file = File::open(path)?;
    let document = file.parse()?;
    let root = document.root_element();
    let encoding = file.encoding(root)?;
    let kind = root.attribute("type").unwrap_or_default();
    let refuse = |why: String| ResolvedError::format(path, why);
    let mut piece = Piece { path: path.to_owned(), sized: true, ..Piece::default() };
    read_field_data(&file, root, &encoding, &mut piece)?;
    let dataset = root.children().find(|child| child.is_element() && child.has_tag_name(kind));
    let dataset = dataset.ok_or_else(|| refuse(format!("it holds no <{kind}>")))?;
    let parts = if let Some(kind) = kind.strip_prefix('P').filter(|kind| *kind != "olyData") {
        let mut parts = Vec::new();
        for part in children(dataset, "Piece") {
            let source = part.attribute("Source");
            let source = source.ok_or_else(|| refuse("a <Piece> has no Source".into()))?;
            let file = File::open(&path.with_file_name(source))?;
            let document = file.parse()?;
            let root = document.root_element();
            let encoding = file.encoding(root)?;
            let inner =
                root.children().find(|child| child.is_element() && child.has_tag_name(kind));
            let inner = inner.ok_or_else(|| {
                ResolvedError::format(&file.path, format!("it holds no <{kind}>"))
            })?;
            if piece.time.is_none() {
                read_field_data(&file, root, &encoding, &mut piece)?;
            }
            for part in children(inner, "Piece") {
                parts.push(Part::read(&file.path, kind, part, &encoding, wanted)?);
            }
        }
        parts
    } else {
        let parts = children(dataset, "Piece");
        parts
            .map(|part| Part::read(path, kind, part, &encoding, wanted))
            .collect::<Result<_, _>>()?
    };
    match kind.trim_start_matches("P") {
        "ImageData" => image(dataset, &mut piece).map_err(refuse)?,
        "RectilinearGrid" => rectilinear(&parts, dataset, &mut piece).map_err(refuse)?,
        _ => {}
    }
    join(parts, &mut piece).map_err(|(array, why)| match array {
        Some(array) => ResolvedError::array(path, &array, why),
        None => ResolvedError::format(path, why),
    })?;
    Ok(piece)
}

/// One <Piece> of a file.
struct Part {
    arrays: Vec<(String, Columns)>,
    others: Vec<(String, Option<&'static str>)>,
    shape: Shape,
}

enum Shape {
    /// First and last corner along each axis.
    Extent([i64; 6]),
    /// The same, with the coordinates of the corners.
    Coordinates([i64; 6], [Vec<f64>; 3]),
    /// Lower and upper corner of each cell.
    Boxes(Vec<[[f64; 3]; 2]>),
    /// Particles, whose positions are the array `Points`.
    Particles,
}

impl Part {
    fn read(
        path: &Path,
        kind: &str,
        part: Node,
        encoding: &Encoding,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<Self, ResolvedError> {
        let refuse = |why: String| ResolvedError::format(path, why);
        let particles = kind == "PolyData";
        let [held, other] =
            if particles { ["PointData", "CellData"] } else { ["CellData", "PointData"] };
        let mut read = Self { arrays: Vec::new(), others: Vec::new(), shape: Shape::Particles };
        let mut ghosts = None;
        for array in child(part, held).into_iter().flat_map(|data| children(data, "DataArray")) {
            let name = array.attribute("Name").unwrap_or_default();
            let ghost = name == "vtkGhostType" || name == "vtkGhostLevels";
            if !ghost && !wanted(name) {
                read.others.push((name.to_owned(), None));
                continue;
            }
            let values = values(path, array, encoding)?;
            if ghost {
                ghosts = values.into_iter().next();
            } else {
                read.arrays.push((name.to_owned(), values));
            }
        }
        for array in child(part, other).into_iter().flat_map(|data| children(data, "DataArray")) {
            let name = array.attribute("Name").unwrap_or_default().to_owned();
            let why =
                if particles { "it is data of cells and not of particles" } else { POINT_DATA };
            read.others.push((name, Some(why)));
        }
        read.shape = match kind {
            "ImageData" => Shape::Extent(attribute(part, "Extent").map_err(refuse)?),
            "RectilinearGrid" => {
                let coordinates = child(part, "Coordinates");
                let mut axes =
                    coordinates.into_iter().flat_map(|node| children(node, "DataArray")).map(
                        |array| values(path, array, encoding).map(|mut columns| columns.remove(0)),
                    );
                let mut axis =
                    || axes.next().unwrap_or_else(|| Err(refuse("a coordinate is missing".into())));
                let coordinates = [axis()?, axis()?, axis()?];
                Shape::Coordinates(attribute(part, "Extent").map_err(refuse)?, coordinates)
            }
            "UnstructuredGrid" => Shape::Boxes(boxes(path, part, encoding)?),
            "PolyData" => {
                let points = points(path, part, encoding)?;
                read.arrays.push(("Points".into(), points));
                Shape::Particles
            }
            other => {
                return Err(refuse(format!(
                    "it is {other}: ImageData (.vti), RectilinearGrid (.vtr), UnstructuredGrid \
                     (.vtu) and PolyData (.vtp) are read"
                )));
            }
        };
        if let (Some(ghosts), Shape::Boxes(boxes)) = (ghosts, &mut read.shape) {
            // Cells that another piece has.
            let keep = |n: usize| ghosts.get(n).is_none_or(|ghost| *ghost == 0.0);
            let mut n = 0;
            boxes.retain(|_| {
                n += 1;
                keep(n - 1)
            });
            for column in read.arrays.iter_mut().flat_map(|(_, columns)| columns) {
                let mut n = 0;
                column.retain(|_| {
                    n += 1;
                    keep(n - 1)
                });
            }
        }
        Ok(read)
    }
}

/// The components of a DataArray.
fn values(path: &Path, array: Node, encoding: &Encoding) -> Result<Columns, ResolvedError> {
    let name = array.attribute("Name").unwrap_or_default();
    let refuse = |why: String| ResolvedError::array(path, name, why);
    let values = encoding.values(array).map_err(refuse)?;
    let count = array.attribute("NumberOfComponents").and_then(|count| count.parse().ok());
    let count = count.unwrap_or(1).max(1);
    if values.len() % count != 0 {
        return Err(refuse(format!("{} values are not of {count} components each", values.len())));
    }
    if count == 1 {
        return Ok(vec![values]);
    }
    Ok((0..count).map(|c| values.iter().skip(c).step_by(count).copied().collect()).collect())
}

fn points(path: &Path, part: Node, encoding: &Encoding) -> Result<Columns, ResolvedError> {
    let array = child(part, "Points").and_then(|points| child(points, "DataArray"));
    let array = array.ok_or_else(|| ResolvedError::format(path, "it has no <Points>"))?;
    let points = values(path, array, encoding)?;
    match points.len() {
        3 => Ok(points),
        count => Err(ResolvedError::format(path, format!("its points have {count} coordinates"))),
    }
}

/// Corners of the cells of an unstructured grid.
fn boxes(
    path: &Path,
    part: Node,
    encoding: &Encoding,
) -> Result<Vec<[[f64; 3]; 2]>, ResolvedError> {
    let points = points(path, part, encoding)?;
    let cells = child(part, "Cells");
    let list = |name: &str| {
        let array = cells
            .into_iter()
            .flat_map(|cells| children(cells, "DataArray"))
            .find(|array| array.attribute("Name") == Some(name));
        let array =
            array.ok_or_else(|| ResolvedError::format(path, format!("<Cells> has no {name}")))?;
        Ok(values(path, array, encoding)?.remove(0))
    };
    let (connectivity, offsets, types) = (list("connectivity")?, list("offsets")?, list("types")?);
    let mut boxes = Vec::with_capacity(types.len());
    let mut begin = 0;
    for (n, (kind, end)) in types.iter().zip(&offsets).enumerate() {
        let refuse = |why: String| ResolvedError::format(path, format!("cell {n} {why}"));
        let corners = BOXES.iter().find(|(known, _)| f64::from(*known) == *kind);
        let (_, corners) = corners.ok_or_else(|| {
            refuse(format!(
                "is of type {kind}, and boxes are read: hexahedra (12), voxels (11), \
                 quadrilaterals (9) and pixels (8); resample to a uniform grid"
            ))
        })?;
        let end = *end as usize;
        let ids = connectivity.get(begin..end).filter(|ids| ids.len() == *corners);
        let ids = ids.ok_or_else(|| refuse(format!("does not have {corners} corners")))?;
        begin = end;
        let mut corner = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for id in ids {
            for axis in 0..3 {
                let at = points[axis].get(*id as usize);
                let at =
                    *at.ok_or_else(|| refuse(format!("has a corner {id} that is no point")))?;
                corner[0][axis] = corner[0][axis].min(at);
                corner[1][axis] = corner[1][axis].max(at);
            }
        }
        boxes.push(corner);
    }
    Ok(boxes)
}

/// The lattice of an image.
fn image(dataset: Node, piece: &mut Piece) -> Result<(), String> {
    let extent: [i64; 6] = attribute(dataset, "WholeExtent")?;
    if let Some(direction) = dataset.attribute("Direction") {
        let numbers: [f64; 9] = attribute(dataset, "Direction")?;
        if numbers != [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0] {
            return Err(format!(
                "its axes are turned, Direction = \"{direction}\": turn them back"
            ));
        }
    }
    let spacing: [f64; 3] = attribute(dataset, "Spacing")?;
    let origin: [f64; 3] = attribute(dataset, "Origin")?;
    let cells = cells(&extent)?;
    if let Some(axis) = (0..3).find(|axis| spacing[*axis].is_nan() || spacing[*axis] <= 0.0) {
        return Err(format!("its Spacing along axis {axis} is {}", spacing[axis]));
    }
    piece.lattice = Some(Lattice {
        cells,
        spacing,
        origin: std::array::from_fn(|axis| origin[axis] + extent[2 * axis] as f64 * spacing[axis]),
    });
    Ok(())
}

/// Cells along each axis between the corners of `extent`; one where it is flat.
fn cells(extent: &[i64; 6]) -> Result<[usize; 3], String> {
    let mut cells = [1; 3];
    for axis in 0..3 {
        let span = extent[2 * axis + 1].checked_sub(extent[2 * axis]).filter(|span| *span >= 0);
        let span = span.ok_or_else(|| format!("its extent {extent:?} is not one"))?;
        cells[axis] = usize::try_from(span.max(1)).map_err(|error| error.to_string())?;
    }
    cells
        .iter()
        .try_fold(1usize, |count, n| count.checked_mul(*n))
        .map(|_| cells)
        .ok_or_else(|| format!("its extent {extent:?} is too large"))
}

/// The lattice of a rectilinear grid, whose coordinates must be equally spaced.
fn rectilinear(parts: &[Part], dataset: Node, piece: &mut Piece) -> Result<(), String> {
    let whole: [i64; 6] = attribute(dataset, "WholeExtent")?;
    let count = cells(&whole)?;
    let mut lattice = Lattice { cells: count, spacing: [1.0; 3], origin: [0.0; 3] };
    for axis in 0..3 {
        // Coordinates by corner number; parts share corners.
        let mut all = Vec::new();
        for part in parts {
            let Shape::Coordinates(extent, coordinates) = &part.shape else { continue };
            let first = extent[2 * axis];
            all.extend(coordinates[axis].iter().zip(first..).map(|(at, corner)| (corner, *at)));
        }
        let at = |corner| all.iter().find(|(number, _)| *number == corner).map(|(_, at)| *at);
        let (Some(low), Some(high)) = (at(whole[2 * axis]), at(whole[2 * axis + 1])) else {
            return Err(format!("its coordinates along {} are not all there", super::AXES[axis]));
        };
        lattice.origin[axis] = low;
        if whole[2 * axis] == whole[2 * axis + 1] {
            continue;
        }
        let spacing = (high - low) / count[axis] as f64;
        for (corner, at) in &all {
            let expected = low + (corner - whole[2 * axis]) as f64 * spacing;
            if spacing <= 0.0 || (at - expected).abs() > 1e-3 * spacing {
                return Err(format!(
                    "corner {corner} along {} lies at {at}, and at {expected} on a uniform grid: \
                     resample to equal cells first",
                    super::AXES[axis]
                ));
            }
        }
        lattice.spacing[axis] = spacing;
    }
    piece.lattice = Some(lattice);
    Ok(())
}

/// Puts the parts together.
fn join(parts: Vec<Part>, piece: &mut Piece) -> Result<(), (Option<String>, String)> {
    let Some(first) = parts.first() else { return Err((None, "it holds no <Piece>".into())) };
    piece.others = first.others.clone();
    let names: Vec<_> =
        first.arrays.iter().map(|(name, columns)| (name.clone(), columns.len())).collect();
    piece.particles = matches!(first.shape, Shape::Particles);
    // For every part the numbers of its cells on the whole lattice.
    let mut places: Vec<Vec<usize>> = Vec::new();
    if parts.iter().all(|part| matches!(part.shape, Shape::Boxes(_))) {
        let all: Vec<_> = parts
            .iter()
            .flat_map(|part| match &part.shape {
                Shape::Boxes(boxes) => &boxes[..],
                _ => &[],
            })
            .copied()
            .collect();
        let (lattice, mut numbers) = Lattice::of_boxes(&all).map_err(|why| (None, why))?;
        piece.lattice = Some(lattice);
        for part in parts.iter().rev() {
            if let Shape::Boxes(boxes) = &part.shape {
                places.insert(0, numbers.split_off(numbers.len() - boxes.len()));
            }
        }
    } else if let Some(lattice) = piece.lattice {
        let low = parts.iter().fold([i64::MAX; 3], |low, part| match &part.shape {
            Shape::Extent(extent) | Shape::Coordinates(extent, _) => {
                std::array::from_fn(|axis| low[axis].min(extent[2 * axis]))
            }
            _ => low,
        });
        for part in &parts {
            let (Shape::Extent(extent) | Shape::Coordinates(extent, _)) = &part.shape else {
                return Err((None, "its pieces are of different kinds".into()));
            };
            let count = cells(extent).map_err(|why| (None, why))?;
            let offset: [usize; 3] =
                std::array::from_fn(|axis| (extent[2 * axis] - low[axis]) as usize);
            if (0..3).any(|axis| offset[axis] + count[axis] > lattice.cells[axis]) {
                return Err((None, format!("a piece of extent {extent:?} leaves the whole")));
            }
            let [nx, ny, _] = lattice.cells;
            let number = |n: usize| {
                let [i, j, k] = [n % count[0], n / count[0] % count[1], n / (count[0] * count[1])];
                offset[0] + i + nx * (offset[1] + j + ny * (offset[2] + k))
            };
            places.push((0..count.iter().product()).map(number).collect());
        }
    } else {
        let mut begin = 0;
        for part in &parts {
            let count = part.arrays.iter().find(|(name, _)| name == "Points");
            let count = count.map_or(0, |(_, columns)| columns[0].len());
            places.push((begin..begin + count).collect());
            begin += count;
        }
    }
    let total = places.iter().map(Vec::len).sum::<usize>();
    let len = piece.lattice.map_or(total, |lattice| lattice.len());
    if total != len {
        return Err((None, format!("its pieces have {total} cells and the whole has {len}")));
    }
    for (name, count) in names {
        let mut columns = vec![vec![f64::NAN; len]; count];
        for (part, places) in parts.iter().zip(&places) {
            let found = part.arrays.iter().find(|(other, _)| *other == name);
            let found = found.filter(|(_, found)| found.len() == count);
            let Some((_, found)) = found else {
                return Err((Some(name), "it is not in all pieces alike".into()));
            };
            for (to, from) in columns.iter_mut().zip(found) {
                if from.len() != places.len() {
                    let why = format!("it has {} values for {} cells", from.len(), places.len());
                    return Err((Some(name), why));
                }
                for (place, value) in places.iter().zip(from) {
                    to[*place] = *value;
                }
            }
        }
        piece.arrays.push(Array { name, columns, dimensions: None });
    }
    Ok(())
}

/// Time, axes and what Favre adds, from <FieldData>.
fn read_field_data(
    file: &File,
    root: Node,
    encoding: &Encoding,
    piece: &mut Piece,
) -> Result<(), ResolvedError> {
    let fields = root
        .descendants()
        .filter(|node| node.has_tag_name("FieldData"))
        .flat_map(|data| children(data, "DataArray"));
    for array in fields {
        let name = array.attribute("Name").unwrap_or_default();
        if !["TimeValue", "TIME", "periodic", "vertical", "signals", "case"].contains(&name) {
            continue;
        }
        let refuse = |why: String| ResolvedError::array(&file.path, name, why);
        let values = encoding.values(array).map_err(refuse)?;
        let wrong = || refuse(format!("{} values are not expected", values.len()));
        match name {
            "TimeValue" | "TIME" => piece.time = values.first().copied(),
            "vertical" => piece.vertical = values.first().map(|axis| (*axis as usize).min(2)),
            "periodic" => {
                let flags: [f64; 3] = values[..].try_into().map_err(|_| wrong())?;
                piece.periodic = Some(flags.map(|flag| flag != 0.0));
            }
            "signals" => {
                let signals: [f64; 8] = values[..].try_into().map_err(|_| wrong())?;
                let half = |at: usize| std::array::from_fn(|n| signals[at + n]);
                piece.signals = Some([half(0), half(4)]);
            }
            _ => {
                let bytes: Vec<u8> = values.iter().map(|byte| *byte as u8).collect();
                piece.case = Some(String::from_utf8(bytes).map_err(|_| wrong())?);
            }
        }
    }
    Ok(())
}
