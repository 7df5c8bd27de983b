//! NumPy's .npy and .npz, read and written.
//!
//! Read: versions 1 to 3, real numbers and booleans of any size and byte order, C and Fortran order;
//! archives stored or deflated. Written: version 1, `<f8` or `|u1`, C order, archives stored, with no
//! time in them, so that equal fields are equal bytes.

use super::{Array, Columns, Lattice, Piece, ResolvedError, decode};
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// What a .npy begins with.
const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// Longest header that is read \[bytes\].
const LONGEST_HEADER: usize = 1 << 20;

/// An array of a .npy.
#[derive(Clone, Debug, PartialEq)]
pub struct Npy {
    /// Its extents, the first index slowest.
    pub shape: Vec<usize>,
    /// Its values, the last index fastest.
    pub values: Vec<f64>,
}

impl Npy {
    /// Reads a .npy.
    ///
    /// # Errors
    /// What is wrong with it, or what of it is not read.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let rest = bytes.strip_prefix(MAGIC).ok_or("it does not begin as a .npy does")?;
        let cut = "it ends within its header";
        let (&major, rest) = rest.split_first().ok_or(cut)?;
        let size = if major == 1 { 2 } else { 4 };
        let length = rest.get(1..1 + size).ok_or(cut)?;
        let length = length.iter().rev().fold(0, |length, byte| length << 8 | *byte as usize);
        if length > LONGEST_HEADER {
            return Err(format!("its header would be {length} bytes long"));
        }
        let header = rest.get(1 + size..1 + size + length).ok_or(cut)?;
        let header = str::from_utf8(header).map_err(|_| "its header is not text")?;
        let data = &rest[1 + size + length..];
        let kind = entry(header, "descr")?.trim_matches(['\'', '"']).to_owned();
        let fortran = match entry(header, "fortran_order")?.as_str() {
            "True" => true,
            "False" => false,
            other => return Err(format!("fortran_order is {other} in its header")),
        };
        let shape = entry(header, "shape")?;
        let shape: Vec<usize> = shape
            .trim_matches(['(', ')'])
            .split(',')
            .map(str::trim)
            .filter(|extent| !extent.is_empty())
            .map(|extent| extent.parse().map_err(|_| format!("an extent is {extent}")))
            .collect::<Result<_, _>>()?;
        let count = shape.iter().try_fold(1usize, |count, extent| count.checked_mul(*extent));
        let values = numbers(&kind, data)?;
        if count != Some(values.len()) {
            return Err(format!("it has {} values and its shape is {shape:?}", values.len()));
        }
        let values = if fortran { to_c_order(&values, &shape) } else { values };
        Ok(Self { shape, values })
    }
}

/// The value of `key` in a header such as `{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }`.
fn entry(header: &str, key: &str) -> Result<String, String> {
    let missing = || format!("its header has no {key}: {}", header.trim());
    let at = [format!("'{key}'"), format!("\"{key}\"")];
    let at = at.iter().find_map(|key| header.find(key).map(|at| at + key.len()));
    let rest = header[at.ok_or_else(missing)?..].trim_start();
    let rest = rest.strip_prefix(':').ok_or_else(missing)?.trim_start();
    let end = match rest.as_bytes().first() {
        Some(b'(') => rest.find(')').map(|end| end + 1),
        // A structured type is a list, which no number is.
        Some(b'[') => return Err("its elements are structures: arrays of numbers are read".into()),
        _ => rest.find([',', '}']),
    };
    Ok(rest[..end.ok_or_else(missing)?].trim().to_owned())
}

/// The numbers of NumPy's type `kind` in `data`.
fn numbers(kind: &str, data: &[u8]) -> Result<Vec<f64>, String> {
    let code = kind.trim_start_matches(['<', '>', '|', '=']);
    let code = if code == "b1" { "u1" } else { code };
    decode(code, kind.starts_with('>'), data).unwrap_or_else(|| {
        Err(format!(
            "its elements are of type {kind}: real numbers are read (f4, f8, i1 to i8, u1 to u8); \
             save it with .astype(\"f8\")"
        ))
    })
}

/// `values` whose first index is fastest, with the last one fastest.
fn to_c_order(values: &[f64], shape: &[usize]) -> Vec<f64> {
    let mut index = vec![0; shape.len()];
    let strides: Vec<usize> = (0..shape.len()).map(|axis| shape[..axis].iter().product()).collect();
    (0..values.len())
        .map(|_| {
            let from: usize = index.iter().zip(&strides).map(|(i, stride)| i * stride).sum();
            for axis in (0..shape.len()).rev() {
                index[axis] += 1;
                if index[axis] < shape[axis] {
                    break;
                }
                index[axis] = 0;
            }
            values[from]
        })
        .collect()
}

/// How a map says that NumPy arrays are laid out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// The axes in the order of the indices: `zyx`, `xyz`, `yx`, `xz`, ...
    pub axes: Option<String>,
    /// Whether the components are the first index or the last, where both could be.
    pub components_first: Option<bool>,
}

/// Names in an archive that say what NumPy has no place for.
const SPECIAL: [&str; 8] =
    ["time", "spacing", "origin", "periodic", "axes", "case", "signals", "vertical"];

/// Reads the .npz, the .npy or the folder of .npy at `path`; arrays that `wanted` refuses are left out.
///
/// # Errors
/// A file cannot be read, is damaged, or its arrays are of different shapes.
pub fn read(
    path: &Path,
    layout: &Layout,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Piece, ResolvedError> {
    let mut piece = Piece { path: path.to_owned(), ..Piece::default() };
    let mut arrays = Vec::new();
    let mut take = |name: &str, read: &mut dyn FnMut() -> Result<Npy, ResolvedError>| {
        if wanted(name) || SPECIAL.contains(&name) {
            arrays.push((name.to_owned(), read()?));
        } else {
            piece.others.push((name.to_owned(), None));
        }
        Ok(())
    };
    for_each_array(path, &mut take)?;
    let mut axes = layout.axes.clone();
    let (mut spacing, mut origin) = (None, None);
    for (name, npy) in arrays.iter().filter(|(name, _)| SPECIAL.contains(&name.as_str())) {
        let wrong = || {
            ResolvedError::array(path, name, format!("its shape {:?} is not expected", npy.shape))
        };
        let text = || {
            let bytes: Vec<u8> = npy.values.iter().map(|byte| *byte as u8).collect();
            String::from_utf8(bytes).map_err(|_| ResolvedError::array(path, name, "it is not text"))
        };
        match name.as_str() {
            "time" => piece.time = Some(*npy.values.first().ok_or_else(wrong)?),
            "spacing" => spacing = Some(triple(&npy.values, 1.0).ok_or_else(wrong)?),
            "origin" => origin = Some(triple(&npy.values, 0.0).ok_or_else(wrong)?),
            "periodic" => {
                let flags = triple(&npy.values, 0.0).ok_or_else(wrong)?;
                piece.periodic = Some(flags.map(|flag| flag != 0.0));
            }
            "vertical" => {
                let axis = npy.values.first().ok_or_else(wrong)?;
                piece.vertical = Some((*axis as usize).min(2));
            }
            "axes" if axes.is_none() => axes = Some(text()?),
            "case" => piece.case = Some(text()?),
            "signals" => {
                let signals: [f64; 8] = npy.values[..].try_into().map_err(|_| wrong())?;
                let half = |at: usize| std::array::from_fn(|n| signals[at + n]);
                piece.signals = Some([half(0), half(4)]);
            }
            _ => {}
        }
    }
    arrays.retain(|(name, _)| !SPECIAL.contains(&name.as_str()));
    let order = axes.as_deref().map(order).transpose();
    let order = order.map_err(|why| ResolvedError::format(path, why))?;
    let mut cells = None;
    // The arrays of fewest axes are scalars and have the shape of the grid.
    if let Some((_, npy)) = arrays.iter().min_by_key(|(_, npy)| npy.shape.len()) {
        let Some(order) = &order else {
            return Err(ResolvedError::format(
                path,
                "an array does not say which of its indices is which axis: give [grid] \
                 axes = \"zyx\" (x fastest in NumPy's usual order) or axes = \"xyz\"; two letters \
                 in two dimensions",
            ));
        };
        if npy.shape.len() != order.len() {
            let (name, _) = &arrays[0];
            return Err(ResolvedError::array(
                path,
                name,
                format!("its shape is {:?} and axes names {} axes", npy.shape, order.len()),
            ));
        }
        let mut extents = [1; 3];
        for (extent, axis) in npy.shape.iter().zip(order) {
            extents[*axis] = *extent;
        }
        cells = Some((extents, npy.shape.clone(), order.clone()));
    }
    for (name, npy) in arrays {
        if let Some((extents, grid, order)) = &cells {
            let columns = columns(&npy, grid, order, extents, layout.components_first)
                .map_err(|why| ResolvedError::array(path, &name, why))?;
            piece.arrays.push(Array { name, columns, dimensions: None });
        }
    }
    if let Some((cells, ..)) = cells {
        piece.sized = spacing.is_some();
        piece.lattice = Some(Lattice {
            cells,
            spacing: spacing.unwrap_or([1.0; 3]),
            origin: origin.unwrap_or([0.0; 3]),
        });
    }
    Ok(piece)
}

/// The time in a .npz or a folder of .npy, if it has one.
///
/// # Errors
/// It cannot be read.
pub fn time(path: &Path) -> Result<Option<f64>, ResolvedError> {
    let mut time = None;
    let mut take = |name: &str, read: &mut dyn FnMut() -> Result<Npy, ResolvedError>| {
        if name == "time" {
            time = read()?.values.first().copied();
        }
        Ok(())
    };
    for_each_array(path, &mut take)?;
    Ok(time)
}

type Take<'a> = &'a mut dyn FnMut(
    &str,
    &mut dyn FnMut() -> Result<Npy, ResolvedError>,
) -> Result<(), ResolvedError>;

/// Offers each array at `path` by its name to `take`, in the order of the names.
fn for_each_array(path: &Path, take: Take<'_>) -> Result<(), ResolvedError> {
    let npy = |path: &Path| {
        let bytes = fs::read(path).map_err(ResolvedError::read(path))?;
        Npy::read(&bytes).map_err(|why| ResolvedError::format(path, why))
    };
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if path.is_dir() {
        let read = fs::read_dir(path).map_err(ResolvedError::read(path))?;
        let mut files = Vec::new();
        for entry in read {
            let file = entry.map_err(ResolvedError::read(path))?.path();
            if file.extension().is_some_and(|end| end == "npy") {
                files.push(file);
            }
        }
        files.sort();
        return files.iter().try_for_each(|file| take(&stem(file), &mut || npy(file)));
    }
    if path.extension().is_some_and(|end| end == "npy") {
        return take(&stem(path), &mut || npy(path));
    }
    let damaged = |error: zip::result::ZipError| ResolvedError::format(path, error.to_string());
    let file = File::open(path).map_err(ResolvedError::read(path))?;
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(damaged)?;
    let names: Result<Vec<_>, _> =
        archive.file_names().map(|name| name.map(|name| name.into_owned())).collect();
    let mut names = names.map_err(damaged)?;
    names.sort();
    for name in names {
        take(name.trim_end_matches(".npy"), &mut || {
            let mut bytes = Vec::new();
            let mut member = archive.by_name(&name).map_err(damaged)?;
            let read = member.read_to_end(&mut bytes);
            read.map_err(|error| ResolvedError::format(path, format!("{name}: {error}")))?;
            Npy::read(&bytes)
                .map_err(|why| ResolvedError::array(path, name.trim_end_matches(".npy"), why))
        })?;
    }
    Ok(())
}

/// Two or three numbers along x, y and z.
fn triple(values: &[f64], rest: f64) -> Option<[f64; 3]> {
    match *values {
        [x, y] => Some([x, y, rest]),
        [x, y, z] => Some([x, y, z]),
        _ => None,
    }
}

/// The axes of `zyx`.
fn order(axes: &str) -> Result<Vec<usize>, String> {
    let order: Option<Vec<usize>> =
        axes.chars().map(|name| "xyz".find(name.to_ascii_lowercase())).collect();
    let sound = |order: &Vec<usize>| {
        (2..=3).contains(&order.len()) && (1..order.len()).all(|n| !order[..n].contains(&order[n]))
    };
    order.filter(sound).ok_or(format!(
        "axes = \"{axes}\": two or three of the letters x, y and z are accepted, each once, such as \
         \"zyx\""
    ))
}

/// The components of `npy`, each with x fastest, on a grid whose shape is `grid` in the array's own
/// order of axes.
fn columns(
    npy: &Npy,
    grid: &[usize],
    order: &[usize],
    extents: &[usize; 3],
    components_first: Option<bool>,
) -> Result<Columns, String> {
    let shape = &npy.shape;
    let first = shape.len() == grid.len() + 1 && shape[1..] == *grid;
    let last = shape.len() == grid.len() + 1 && shape[..grid.len()] == *grid;
    let len: usize = grid.iter().product();
    let (count, first) = match (first, last, components_first) {
        _ if shape == grid => (1, true),
        (true, false, _) | (true, true, Some(true)) => (shape[0], true),
        (false, true, _) | (true, true, Some(false)) => (shape[grid.len()], false),
        (true, true, None) => {
            return Err(format!(
                "its shape {shape:?} has the components first or last: give [grid] components = \
                 \"first\" or \"last\""
            ));
        }
        (false, false, _) => {
            return Err(format!(
                "its shape is {shape:?} and the grid's is {grid:?}: an array of the grid's shape is \
                 accepted, with the components as one more index, first or last"
            ));
        }
    };
    // Distance between neighbours along each of the array's indices.
    let mut strides = [0; 3];
    let mut stride = if first { 1 } else { count };
    for (extent, axis) in grid.iter().zip(order).rev() {
        strides[*axis] = stride;
        stride *= extent;
    }
    let step = if first { len } else { 1 };
    let [nx, ny, nz] = *extents;
    let column = |component: usize| {
        let mut column = Vec::with_capacity(len);
        for k in 0..nz {
            for j in 0..ny {
                let row = component * step + k * strides[2] + j * strides[1];
                column.extend((0..nx).map(|i| npy.values[row + i * strides[0]]));
            }
        }
        column
    };
    Ok((0..count).map(column).collect())
}

/// Writes the header of a .npy of `kind` (`<f8`, `|u1`) and `shape`.
fn write_header(to: &mut dyn Write, kind: &str, shape: &[usize]) -> io::Result<()> {
    let mut extents: String = shape.iter().map(|extent| format!("{extent}, ")).collect();
    if shape.len() > 1 {
        extents.truncate(extents.len() - 2);
    }
    let mut header = format!(
        "{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}",
        extents.trim_end()
    );
    // The data begin at a multiple of 64 bytes.
    let before = MAGIC.len() + 4;
    let length = (before + header.len() + 1).next_multiple_of(64) - before;
    header.extend(std::iter::repeat_n(' ', length - 1 - header.len()));
    header.push('\n');
    to.write_all(MAGIC)?;
    to.write_all(&[1, 0])?;
    to.write_all(&(length as u16).to_le_bytes())?;
    to.write_all(header.as_bytes())
}

/// An archive while it is written.
pub struct NpzWriter<W: Write + Seek> {
    zip: ZipWriter<W>,
}

impl<W: Write + Seek> NpzWriter<W> {
    /// An archive to `writer`.
    pub fn new(writer: W) -> Self {
        Self { zip: ZipWriter::new(writer) }
    }

    fn begin(&mut self, name: &str, bytes: usize) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(zip::DateTime::default())
            .large_file(bytes >= u32::MAX as usize / 2);
        Ok(self.zip.start_file(format!("{name}.npy"), options)?)
    }

    /// Adds numbers; `parts` follow each other, and together fill `shape`.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn numbers(&mut self, name: &str, shape: &[usize], parts: &[&[f64]]) -> io::Result<()> {
        self.begin(name, 8 * parts.iter().map(|part| part.len()).sum::<usize>())?;
        write_header(&mut self.zip, "<f8", shape)?;
        let mut bytes = Vec::new();
        for part in parts {
            bytes.clear();
            bytes.extend(part.iter().flat_map(|value| value.to_le_bytes()));
            self.zip.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Adds text, as its bytes in UTF-8.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        self.begin(name, text.len())?;
        write_header(&mut self.zip, "|u1", &[text.len()])?;
        self.zip.write_all(text.as_bytes())
    }

    /// Ends the archive.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn finish(self) -> io::Result<W> {
        Ok(self.zip.finish()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn either_order_and_any_type_give_the_same_numbers() {
        let c: Vec<u8> = (0..6).flat_map(|n: i32| (n as f32).to_be_bytes()).collect();
        let c = npy("{'descr': '>f4', 'fortran_order': False, 'shape': (2, 3), }\n", &c);
        let f: Vec<u8> = [0i16, 3, 1, 4, 2, 5].into_iter().flat_map(i16::to_le_bytes).collect();
        let f = npy("{'descr': '<i2', 'fortran_order': True, 'shape': (2, 3), }\n", &f);
        let expected = Npy { shape: vec![2, 3], values: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0] };
        assert_eq!(Npy::read(&c).unwrap(), expected);
        assert_eq!(Npy::read(&f).unwrap(), expected);
    }

    #[test]
    fn what_is_not_read_is_said() {
        let good = "{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }";
        for (bytes, why) in [
            (b"PK".to_vec(), "does not begin"),
            (npy(good, &[0; 16])[..20].to_vec(), "ends within its header"),
            (npy(good, &[0; 15]), "15 bytes are no whole number"),
            (npy(good, &[0; 8]), "it has 1 values and its shape is [2]"),
            (npy(&good.replace("<f8", "<c16"), &[0; 32]), ".astype"),
            (npy(&good.replace("'<f8'", "[('a', '<f8')]"), &[0; 16]), "structures"),
            (npy("{}", &[]), "no descr"),
        ] {
            let found = Npy::read(&bytes).unwrap_err();
            assert!(found.contains(why), "{found}");
        }
    }

    #[test]
    fn indices_become_axes_whatever_their_order() {
        // The value at (x, y, z) is 100 x + 10 y + z, on 2 x 3 x 4 cells.
        let value = |x: usize, y: usize, z: usize| (100 * x + 10 * y + z) as f64;
        let mut zyx = Vec::new();
        for z in 0..4 {
            for y in 0..3 {
                zyx.extend((0..2).map(|x| value(x, y, z)));
            }
        }
        let mut xyz = Vec::new();
        for x in 0..2 {
            for y in 0..3 {
                // Two components, the second the negative of the first, as the last index.
                xyz.extend((0..4).flat_map(|z| [value(x, y, z), -value(x, y, z)]));
            }
        }
        let extents = [2, 3, 4];
        let a = Npy { shape: vec![4, 3, 2], values: zyx.clone() };
        let found = columns(&a, &[4, 3, 2], &order("zyx").unwrap(), &extents, None).unwrap();
        assert_eq!(found, [zyx.clone()]);
        let b = Npy { shape: vec![2, 3, 4, 2], values: xyz };
        let found = columns(&b, &[2, 3, 4], &order("xyz").unwrap(), &extents, None).unwrap();
        assert_eq!(found[0], zyx);
        assert!(found[1].iter().zip(&zyx).all(|(a, b)| *a == -b));
        assert!(order("xyx").is_err() && order("xyzt").is_err() && order("x").is_err());
    }

    #[test]
    fn components_that_could_be_first_or_last_are_asked_for() {
        let order = order("yx").unwrap();
        let npy = Npy { shape: vec![2, 2, 2], values: (0..8).map(f64::from).collect() };
        let read = |first| columns(&npy, &[2, 2], &order, &[2, 2, 1], first);
        assert!(read(None).unwrap_err().contains("components = \"first\""));
        assert_eq!(read(Some(true)).unwrap()[0], [0.0, 1.0, 2.0, 3.0]);
        assert_eq!(read(Some(false)).unwrap()[0], [0.0, 2.0, 4.0, 6.0]);
        let wrong = columns(&npy, &[2, 3], &order, &[3, 2, 1], None).unwrap_err();
        assert!(wrong.contains("the grid's is [2, 3]"), "{wrong}");
    }

    #[test]
    fn an_archive_comes_back_as_it_was() {
        let mut writer = NpzWriter::new(io::Cursor::new(Vec::new()));
        let values = [0.1, -0.0, f64::MIN_POSITIVE / 3.0, 1e300, 5.0, 6.0];
        writer.numbers("phi", &[3, 2], &[&values[..2], &values[2..]]).unwrap();
        writer.numbers("spacing", &[2], &[&[0.5, 0.25]]).unwrap();
        writer.text("axes", "yx").unwrap();
        writer.numbers("time", &[1], &[&[2.5]]).unwrap();
        let bytes = writer.finish().unwrap().into_inner();
        let file = tempfile::Builder::new().suffix(".npz").tempfile().unwrap();
        fs::write(file.path(), bytes).unwrap();
        let piece = read(file.path(), &Layout::default(), &|name| name == "phi").unwrap();
        assert_eq!(piece.lattice.unwrap().cells, [2, 3, 1]);
        assert_eq!(piece.lattice.unwrap().spacing, [0.5, 0.25, 1.0]);
        assert_eq!(piece.time, Some(2.5));
        let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&piece.arrays[0].columns[0]), bits(&values));
        assert_eq!(time(file.path()).unwrap(), Some(2.5));
    }
}
