//! OpenFOAM's time folders: volume fields in ascii and binary, gzipped or not, on a mesh of equal
//! boxes such as blockMesh makes of one block.
//!
//! A cell's place follows from the corners of its faces, so cells may be renumbered. Along an axis
//! whose ends are cyclic patches the fields are periodic; `constant/g` says which axis is vertical.

use super::{Array, Columns, Lattice, POINT_DATA, Piece, ResolvedError};
use flate2::read::MultiGzDecoder;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

const FACE_DATA: &str = "it is a field of faces, and a field of cells is needed: reconstruct it \
    to a vol field first";
const LAGRANGIAN: &str = "it is not a field of cells";

/// Whether `path` is a time folder of a case.
pub fn is_time_folder(path: &Path) -> bool {
    path.is_dir() && time_of(path).is_some()
}

/// The time that a folder is named after.
pub fn time_of(path: &Path) -> Option<f64> {
    path.file_name()?.to_str()?.parse().ok().filter(|time: &f64| time.is_finite())
}

/// The time folders of the case at `path`, in the order of time, without the one of time 0; none if it
/// is no case.
///
/// # Errors
/// It is a case without times, or decomposed.
pub fn times(path: &Path) -> Result<Option<Vec<PathBuf>>, ResolvedError> {
    if !path.is_dir() || !path.join("constant").is_dir() {
        return Ok(None);
    }
    let mut folders = Vec::new();
    for entry in fs::read_dir(path).map_err(ResolvedError::read(path))? {
        let folder = entry.map_err(ResolvedError::read(path))?.path();
        if is_time_folder(&folder) && time_of(&folder) != Some(0.0) {
            folders.push(folder);
        }
    }
    folders
        .sort_by(|a, b| time_of(a).partial_cmp(&time_of(b)).unwrap_or(std::cmp::Ordering::Equal));
    if folders.is_empty() {
        let why = if path.join("processor0").is_dir() {
            "the case is decomposed: run reconstructPar first"
        } else {
            "the case has no time folder but that of time 0"
        };
        return Err(ResolvedError::format(path, why));
    }
    Ok(Some(folders))
}

/// A mesh of equal boxes.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Where it stands.
    folder: PathBuf,
    lattice: Lattice,
    /// The number on the lattice of each of the mesh's cells.
    places: Vec<usize>,
    periodic: [bool; 3],
    gravity: Option<[f64; 3]>,
}

impl Mesh {
    /// The mesh of the time folder `time`: that of the case, `constant/polyMesh`.
    ///
    /// # Errors
    /// It cannot be read, or is not of equal boxes.
    pub fn of(time: &Path) -> Result<Self, ResolvedError> {
        let case = case_of(time);
        let folder = case.join("constant/polyMesh");
        if !folder.is_dir() {
            let why =
                if case.file_name().is_some_and(|n| n.to_string_lossy().starts_with("processor")) {
                    "it is a part of a decomposed case: run reconstructPar first".into()
                } else {
                    format!(
                        "it is not in an OpenFOAM case: there is no mesh {}; run blockMesh first",
                        folder.display()
                    )
                };
            return Err(ResolvedError::format(time, why));
        }
        let points = Foam::open(&folder.join("points"))?;
        let points = points.parse(|cursor, style| cursor.list(style, 3))?;
        let faces = Foam::open(&folder.join("faces"))?;
        let faces = faces.parse(|cursor, style| cursor.faces(style))?;
        let labels = |name: &str| {
            Foam::open(&folder.join(name))?.parse(|cursor, style| cursor.labels(style))
        };
        let (owner, neighbour) = (labels("owner")?, labels("neighbour")?);
        let refuse = |why: String| ResolvedError::format(&folder, why);
        let count = owner.iter().max().map_or(0, |last| *last as usize + 1);
        let mut boxes = vec![[[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]]; count];
        let mut bounds = Vec::with_capacity(faces.len());
        for face in &faces {
            let mut bound = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
            for point in face {
                for axis in 0..3 {
                    let at = points[axis].get(*point as usize);
                    let at = *at.ok_or_else(|| refuse(format!("point {point} is missing")))?;
                    bound[0][axis] = bound[0][axis].min(at);
                    bound[1][axis] = bound[1][axis].max(at);
                }
            }
            bounds.push(bound);
        }
        for cells in [&owner, &neighbour] {
            for (cell, bound) in cells.iter().zip(&bounds) {
                let into = boxes.get_mut(*cell as usize);
                let into = into.ok_or_else(|| refuse(format!("cell {cell} is missing")))?;
                for axis in 0..3 {
                    into[0][axis] = into[0][axis].min(bound[0][axis]);
                    into[1][axis] = into[1][axis].max(bound[1][axis]);
                }
            }
        }
        let (lattice, places) = Lattice::of_boxes(&boxes).map_err(refuse)?;
        let boundary = Foam::open(&folder.join("boundary"))?;
        let patches = boundary.parse(|cursor, _| cursor.patches())?;
        let mut periodic = [false; 3];
        for patch in patches.iter().filter(|patch| patch.cyclic) {
            let Some(bound) = bounds.get(patch.start) else { continue };
            if let Some(axis) = (0..3).find(|axis| bound[0][*axis] == bound[1][*axis]) {
                periodic[axis] = true;
            }
        }
        let g = case.join("constant/g");
        let gravity = match Foam::find(&g) {
            Some(_) => Some(Foam::open(&g)?.parse(|cursor, _| cursor.gravity())?),
            None => None,
        };
        Ok(Self { folder, lattice, places, periodic, gravity })
    }

    /// Whether it is the mesh of the time folder `time`.
    pub fn is_of(&self, time: &Path) -> bool {
        self.folder == case_of(time).join("constant/polyMesh")
    }
}

/// The case of a time folder.
pub fn case_of(time: &Path) -> PathBuf {
    match time.parent() {
        Some(case) if !case.as_os_str().is_empty() => case.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// Reads the time folder `path` on its `mesh`; fields that `wanted` refuses are left out.
///
/// # Errors
/// A file cannot be read, is damaged, or has another number of values than the mesh has cells.
pub fn read(
    path: &Path,
    mesh: &Mesh,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Piece, ResolvedError> {
    let mut piece = Piece {
        path: path.to_owned(),
        time: time_of(path),
        lattice: Some(mesh.lattice),
        sized: true,
        periodic: Some(mesh.periodic),
        gravity: mesh.gravity,
        vertical: mesh.gravity.and_then(vertical_axis),
        ..Piece::default()
    };
    let mut files = Vec::new();
    for entry in fs::read_dir(path).map_err(ResolvedError::read(path))? {
        let file = entry.map_err(ResolvedError::read(path))?.path();
        if file.is_file() {
            files.push(file);
        }
    }
    files.sort();
    for file in files {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = name.strip_suffix(".gz").map_or(name.clone(), str::to_owned);
        if !wanted(&name) {
            piece.others.push((name, None));
            continue;
        }
        let refuse = |why: String| ResolvedError::array(path, &name, why);
        let field = Foam::open(&file)?;
        let class = field.class.clone();
        if !class.starts_with("vol") {
            let why = match class.as_str() {
                class if class.starts_with("point") => POINT_DATA,
                class if class.starts_with("surface") => FACE_DATA,
                _ => LAGRANGIAN,
            };
            piece.others.push((name, Some(why)));
            continue;
        }
        let components = match class.as_str() {
            "volScalarField" => 1,
            "volVectorField" => 3,
            "volSymmTensorField" => 6,
            "volTensorField" => 9,
            other => return Err(refuse(format!("its class is {other}, which is not read"))),
        };
        let (dimensions, internal) =
            field.parse(|cursor, style| cursor.field(style, components))?;
        let count = mesh.places.len();
        let mut columns = vec![vec![0.0; count]; components];
        match internal {
            Internal::Uniform(value) => {
                for (column, value) in columns.iter_mut().zip(value) {
                    column.fill(value);
                }
            }
            Internal::List(list) => {
                if list.iter().any(|from| from.len() != count) {
                    let found = list[0].len();
                    return Err(refuse(format!(
                        "it has {found} values and the mesh {count} cells"
                    )));
                }
                for (column, list) in columns.iter_mut().zip(list) {
                    for (place, value) in mesh.places.iter().zip(list) {
                        column[*place] = value;
                    }
                }
            }
        }
        if components == 6 {
            // XX XY XZ YY YZ ZZ to the order of VTK, XX YY ZZ XY YZ XZ.
            let order = [0, 3, 5, 1, 4, 2];
            columns = order.map(|n| std::mem::take(&mut columns[n])).into();
        }
        piece.arrays.push(Array { name, columns, dimensions });
    }
    Ok(piece)
}

/// The axis along which gravity points, if it is one.
fn vertical_axis(gravity: [f64; 3]) -> Option<usize> {
    let mut axes = (0..3).filter(|axis| gravity[*axis] != 0.0);
    let axis = axes.next()?;
    (axes.next().is_none()).then_some(axis)
}

/// A file of OpenFOAM.
struct Foam {
    path: PathBuf,
    bytes: Vec<u8>,
    /// Where its header ends.
    begin: usize,
    class: String,
    style: Style,
}

/// How a file's lists are written.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Style {
    binary: bool,
    /// Bytes of a label and of a scalar.
    label: usize,
    scalar: usize,
    big_endian: bool,
}

impl Foam {
    /// The file at `path`, or the gzipped one.
    fn find(path: &Path) -> Option<PathBuf> {
        let mut zipped = path.as_os_str().to_owned();
        zipped.push(".gz");
        [path.to_owned(), zipped.into()].into_iter().find(|path| path.is_file())
    }

    fn open(path: &Path) -> Result<Self, ResolvedError> {
        let path = Self::find(path).unwrap_or_else(|| path.to_owned());
        let mut bytes = fs::read(&path).map_err(ResolvedError::read(&path))?;
        if bytes.starts_with(&[0x1f, 0x8b]) {
            let mut unpacked = Vec::new();
            MultiGzDecoder::new(&bytes[..])
                .read_to_end(&mut unpacked)
                .map_err(ResolvedError::read(&path))?;
            bytes = unpacked;
        }
        let mut cursor = Cursor { bytes: &bytes, at: 0 };
        let header = cursor.header();
        let begin = cursor.at;
        match header {
            Ok((class, style)) => Ok(Self { path, bytes, begin, class, style }),
            Err(why) => Err(ResolvedError::format(&path, why)),
        }
    }

    fn parse<T>(
        &self,
        parse: impl FnOnce(&mut Cursor, Style) -> Result<T, String>,
    ) -> Result<T, ResolvedError> {
        let mut cursor = Cursor { bytes: &self.bytes, at: self.begin };
        parse(&mut cursor, self.style).map_err(|why| {
            let text = &self.bytes[..cursor.at.min(self.bytes.len())];
            let line = text.iter().filter(|byte| **byte == b'\n').count() + 1;
            let place = if self.style.binary { String::new() } else { format!("line {line}: ") };
            ResolvedError::format(&self.path, format!("{place}{why}"))
        })
    }
}

/// The value of a field in the cells.
enum Internal {
    Uniform(Vec<f64>),
    List(Columns),
}

struct Patch {
    cyclic: bool,
    start: usize,
}

/// Reads a file from its begin to its end.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Cursor<'_> {
    /// Passes blanks and comments.
    fn blank(&mut self) {
        loop {
            let rest = &self.bytes[self.at..];
            let blank = rest.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
            let rest = &rest[blank..];
            self.at += blank;
            let end: &[u8] = match rest {
                [b'/', b'/', ..] => b"\n",
                [b'/', b'*', ..] => b"*/",
                _ => return,
            };
            let found = rest.windows(end.len()).skip(2).position(|window| window == end);
            self.at += found.map_or(rest.len(), |found| found + 2 + end.len());
        }
    }

    fn take(&mut self, wanted: u8) -> bool {
        self.blank();
        let found = self.bytes.get(self.at) == Some(&wanted);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, wanted: u8) -> Result<(), String> {
        if self.take(wanted) {
            return Ok(());
        }
        let wanted = wanted as char;
        match self.peek_word() {
            "" => Err(format!("{wanted} is expected and the file ends")),
            found => Err(format!("{wanted} is expected and not {found}")),
        }
    }

    /// What stands next, up to a blank or a bracket.
    fn peek_word(&mut self) -> &str {
        self.blank();
        let rest = &self.bytes[self.at..];
        let end = |byte: &u8| byte.is_ascii_whitespace() || b"();{}[]".contains(byte);
        let length = rest.iter().position(end).unwrap_or(rest.len()).min(200);
        str::from_utf8(&rest[..length.max(usize::from(!rest.is_empty()))]).unwrap_or("?")
    }

    fn word(&mut self) -> Result<String, String> {
        let word = self.peek_word().to_owned();
        self.at += word.len();
        match word.chars().next() {
            None => Err("a word is expected and the file ends".into()),
            Some(c) if "();{}[]?".contains(c) => Err(format!("a word is expected and not {word}")),
            Some(_) => Ok(word),
        }
    }

    fn number(&mut self) -> Result<f64, String> {
        let word = self.peek_word();
        let number = word.parse().map_err(|_| format!("a number is expected and not {word}"));
        let length = word.len();
        self.at += length;
        number
    }

    /// A number of entries, if one stands next.
    fn count(&mut self) -> Option<usize> {
        let word = self.peek_word();
        let (length, count) = (word.len(), word.parse().ok());
        self.at += if count.is_some() { length } else { 0 };
        count
    }

    /// Passes the entry that begins here, up to its `;` or its closing brace.
    fn skip(&mut self) -> Result<(), String> {
        let mut depth = 0;
        loop {
            self.blank();
            let byte = self.bytes.get(self.at).ok_or("the file ends within an entry")?;
            self.at += 1;
            match byte {
                b'{' | b'(' | b'[' => depth += 1,
                b'}' if depth == 1 => return Ok(()),
                b'}' | b')' | b']' => depth -= 1,
                b';' if depth == 0 => return Ok(()),
                b'"' => {
                    let rest = &self.bytes[self.at..];
                    let end = rest.iter().position(|byte| *byte == b'"');
                    self.at += end.ok_or("a quotation is not closed")? + 1;
                }
                _ => {}
            }
        }
    }

    fn header(&mut self) -> Result<(String, Style), String> {
        let no = "it does not begin with the header of an OpenFOAM file, FoamFile { ... }";
        if self.word().map_err(|_| no)? != "FoamFile" || !self.take(b'{') {
            return Err(no.into());
        }
        let mut style = Style { binary: false, label: 4, scalar: 8, big_endian: false };
        let mut class = String::new();
        while !self.take(b'}') {
            let key = self.word()?;
            self.blank();
            let begin = self.at;
            self.skip()?;
            let value = String::from_utf8_lossy(&self.bytes[begin..self.at - 1]);
            let value = value.trim().trim_matches('"');
            match key.as_str() {
                "format" => style.binary = value == "binary",
                "class" => class = value.to_owned(),
                "arch" => {
                    style.big_endian = value.starts_with("MSB");
                    for part in value.split(';') {
                        let bits = |name: &str| {
                            let bits = part.trim().strip_prefix(name)?.parse::<usize>().ok()?;
                            [32, 64].contains(&bits).then_some(bits / 8)
                        };
                        style.label = bits("label=").unwrap_or(style.label);
                        style.scalar = bits("scalar=").unwrap_or(style.scalar);
                    }
                }
                _ => {}
            }
        }
        Ok((class, style))
    }

    /// `size` bytes per entry, `count` entries, as they stand after an opening bracket.
    fn raw(&mut self, count: usize, size: usize) -> Result<&[u8], String> {
        let end = count.checked_mul(size).and_then(|length| self.at.checked_add(length));
        let end = end.filter(|end| *end <= self.bytes.len());
        let end = end.ok_or("the file ends within a list: it is cut short")?;
        let bytes = &self.bytes[self.at..end];
        self.at = end;
        Ok(bytes)
    }

    /// A list of `components` numbers each.
    fn list(&mut self, style: Style, components: usize) -> Result<Columns, String> {
        let count = self.count();
        if let Some(count) = count
            && self.take(b'{')
        {
            let value = self.value(components)?;
            self.expect(b'}')?;
            return Ok(value.into_iter().map(|value| vec![value; count]).collect());
        }
        self.expect(b'(')?;
        let mut columns = vec![Vec::new(); components];
        match (style.binary, count) {
            (true, Some(count)) => {
                let (size, big) = (style.scalar, style.big_endian);
                let bytes = self.raw(count, components * size)?;
                for (n, bytes) in bytes.chunks_exact(size).enumerate() {
                    columns[n % components].push(scalar(bytes, big));
                }
                self.expect(b')')?;
            }
            _ => {
                while !self.take(b')') {
                    for (column, value) in columns.iter_mut().zip(self.value(components)?) {
                        column.push(value);
                    }
                }
            }
        }
        if let Some(count) = count.filter(|count| *count != columns[0].len()) {
            return Err(format!("a list of {count} has {} entries", columns[0].len()));
        }
        Ok(columns)
    }

    /// One value: a number, or numbers in brackets.
    fn value(&mut self, components: usize) -> Result<Vec<f64>, String> {
        if components == 1 {
            return Ok(vec![self.number()?]);
        }
        self.expect(b'(')?;
        let value = (0..components).map(|_| self.number()).collect::<Result<_, _>>()?;
        self.expect(b')')?;
        Ok(value)
    }

    fn labels(&mut self, style: Style) -> Result<Vec<u64>, String> {
        let count = self.count();
        self.expect(b'(')?;
        if let (true, Some(count)) = (style.binary, count) {
            let bytes = self.raw(count, style.label)?;
            let labels = bytes.chunks_exact(style.label).map(|bytes| label(bytes, style)).collect();
            self.expect(b')')?;
            return Ok(labels);
        }
        let mut labels = Vec::with_capacity(count.unwrap_or(0).min(self.bytes.len()));
        while !self.take(b')') {
            let word = self.peek_word();
            let length = word.len();
            labels.push(word.parse().map_err(|_| format!("a label is expected and not {word}"))?);
            self.at += length;
        }
        Ok(labels)
    }

    /// The corners of faces: a list of lists, in binary two lists, of where each face begins and of
    /// corners.
    fn faces(&mut self, style: Style) -> Result<Vec<Vec<u64>>, String> {
        if style.binary {
            let offsets = self.labels(style)?;
            let corners = self.labels(style)?;
            return offsets
                .windows(2)
                .map(|pair| corners.get(pair[0] as usize..pair[1] as usize).map(<[u64]>::to_vec))
                .collect::<Option<_>>()
                .ok_or_else(|| "a face has corners that are not there".into());
        }
        self.count();
        self.expect(b'(')?;
        let mut faces = Vec::new();
        while !self.take(b')') {
            faces.push(self.labels(style)?);
        }
        Ok(faces)
    }

    fn patches(&mut self) -> Result<Vec<Patch>, String> {
        self.count();
        self.expect(b'(')?;
        let mut patches = Vec::new();
        while !self.take(b')') {
            self.word()?;
            self.expect(b'{')?;
            let mut patch = Patch { cyclic: false, start: 0 };
            while !self.take(b'}') {
                let key = self.word()?;
                match key.as_str() {
                    "type" => {
                        let kind = self.word()?;
                        patch.cyclic = kind.starts_with("cyclic");
                        self.expect(b';')?;
                    }
                    "startFace" => {
                        patch.start = self.number()? as usize;
                        self.expect(b';')?;
                    }
                    _ => self.skip()?,
                }
            }
            patches.push(patch);
        }
        Ok(patches)
    }

    fn gravity(&mut self) -> Result<[f64; 3], String> {
        loop {
            if self.word()? == "value" {
                let value = self.value(3)?;
                return Ok([value[0], value[1], value[2]]);
            }
            self.skip()?;
        }
    }

    /// The dimensions and the values in the cells of a field.
    fn field(
        &mut self,
        style: Style,
        components: usize,
    ) -> Result<(Option<[f64; 7]>, Internal), String> {
        let mut dimensions = None;
        loop {
            self.blank();
            if self.at == self.bytes.len() {
                return Err("it has no internalField".into());
            }
            match self.word()?.as_str() {
                "dimensions" => {
                    self.expect(b'[')?;
                    let mut exponents = [0.0; 7];
                    let mut n = 0;
                    while !self.take(b']') {
                        let exponent = self.number()?;
                        *exponents.get_mut(n).ok_or("more than seven dimensions")? = exponent;
                        n += 1;
                    }
                    self.expect(b';')?;
                    dimensions = Some(exponents);
                }
                "internalField" => {
                    let kind = self.word()?;
                    let internal = match kind.as_str() {
                        "uniform" => Internal::Uniform(self.value(components)?),
                        "nonuniform" => {
                            let list = self.word()?;
                            if !list.starts_with("List<") {
                                return Err(format!("List<...> is expected and not {list}"));
                            }
                            Internal::List(self.list(style, components)?)
                        }
                        other => {
                            return Err(format!(
                                "internalField {other}: uniform or nonuniform is read; have \
                                 OpenFOAM write the field, which expands macros and functions"
                            ));
                        }
                    };
                    return Ok((dimensions, internal));
                }
                word if word.starts_with('#') || word.starts_with('$') => {
                    return Err(format!(
                        "{word} is a directive, which is not read: have OpenFOAM write the field, \
                         which expands macros and functions"
                    ));
                }
                _ => self.skip()?,
            }
        }
    }
}

fn scalar(bytes: &[u8], big: bool) -> f64 {
    match (<[u8; 8]>::try_from(bytes), <[u8; 4]>::try_from(bytes)) {
        (Ok(bytes), _) if big => f64::from_be_bytes(bytes),
        (Ok(bytes), _) => f64::from_le_bytes(bytes),
        (_, Ok(bytes)) if big => f32::from_be_bytes(bytes).into(),
        (_, Ok(bytes)) => f32::from_le_bytes(bytes).into(),
        // Entries are of either size.
        _ => f64::NAN,
    }
}

fn label(bytes: &[u8], style: Style) -> u64 {
    let fold = |label: u64, byte: &u8| label << 8 | u64::from(*byte);
    match style.big_endian {
        true => bytes.iter().fold(0, fold),
        false => bytes.iter().rev().fold(0, fold),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cursor(text: &str) -> Cursor<'_> {
        Cursor { bytes: text.as_bytes(), at: 0 }
    }

    const ASCII: Style = Style { binary: false, label: 4, scalar: 8, big_endian: false };

    #[test]
    fn lists_are_read_in_all_their_forms() {
        let list = |text: &str| cursor(text).list(ASCII, 1);
        assert_eq!(list("3(1 2 3)").unwrap(), [[1.0, 2.0, 3.0]]);
        assert_eq!(list("\n3\n(\n1 // one\n2e-1\n/* two */ -3\n)\n;").unwrap(), [[1.0, 0.2, -3.0]]);
        assert_eq!(list("2{0.5}").unwrap(), [[0.5, 0.5]]);
        assert_eq!(list("(4 5)").unwrap(), [[4.0, 5.0]]);
        assert_eq!(cursor("2((1 2 3) (4 5 6))").list(ASCII, 3).unwrap()[1], [2.0, 5.0]);
        assert_eq!(cursor("2(3(0 1 2)\n4(3 4 5 6))").faces(ASCII).unwrap()[1], [3, 4, 5, 6]);
        assert!(list("3(1 2)").unwrap_err().contains("a list of 3 has 2"));
        assert!(list("3(1 2").unwrap_err().contains("a number is expected"));
        assert!(list("2(a b)").unwrap_err().contains("not a"));
    }

    #[test]
    fn a_field_is_read_past_what_does_not_matter() {
        let text = "dimensions [0 1 -1 0 0 0 0];\nfoo { a (1 2); b \"x;}\"; }\n\
                    internalField nonuniform List<vector> 2((1 2 3)(4 5 6));\nboundaryField {}";
        let (dimensions, internal) = cursor(text).field(ASCII, 3).unwrap();
        assert_eq!(dimensions, Some([0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0]));
        let Internal::List(list) = internal else { panic!("uniform") };
        assert_eq!(list, [[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]);
        let refused = |text: &str| cursor(text).field(ASCII, 1).err().unwrap();
        assert!(refused("#include \"x\"\n").contains("directive"));
        assert!(refused("internalField $p;").contains("expands macros"));
        assert!(refused("dimensions [0 0 0 0 0 0 0];").contains("no internalField"));
    }

    #[test]
    fn binary_lists_are_read_in_either_size() {
        let mut bytes = b"2\n(".to_vec();
        bytes.extend([1.5f32, -2.0].iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend(b");");
        let style = Style { binary: true, scalar: 4, ..ASCII };
        let mut cursor = Cursor { bytes: &bytes, at: 0 };
        assert_eq!(cursor.list(style, 1).unwrap(), [[1.5, -2.0]]);
        let mut cut = Cursor { bytes: &bytes[..8], at: 0 };
        assert!(cut.list(style, 1).unwrap_err().contains("cut short"));
    }
}
