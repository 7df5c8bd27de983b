//! Numbers in a file: little-endian, with a checksum at the end, checked before anything is believed.
//!
//! A file begins with eight bytes that say what it is and the version of its format (u32), and ends
//! with the CRC-32 (IEEE 802.3) of all before it (u32). A text is its length (u64) and UTF-8; a list
//! its length (u64) and its elements.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Seek, Write};
use std::path::Path;

/// Bytes of the checksum at the end.
pub(crate) const CHECKSUM: u64 = 4;

/// Memory between a file and what reads or writes it, a number at a time \[bytes\].
const BUFFER: usize = 1 << 18;

/// Writes a file: `magic`, the version of its `format`, what `write` writes, the checksum. It is on
/// disk when this returns.
pub(crate) fn write_file(
    path: &Path,
    magic: &[u8; 8],
    format: u32,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut file = File::create(path)?;
    write_to(&mut file, magic, format, write)?;
    file.sync_all()
}

/// Writes the same to an open file.
pub(crate) fn write_to(
    to: &mut dyn Write,
    magic: &[u8; 8],
    format: u32,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut file = BufWriter::with_capacity(BUFFER, Summed { inner: to, crc: Crc::new() });
    file.write_all(magic)?;
    file.write_all(&format.to_le_bytes())?;
    write(&mut file)?;
    let Summed { inner, crc } = file.into_inner().map_err(|error| error.into_error())?;
    inner.write_all(&crc.value().to_le_bytes())
}

/// What may be wrong with a file, whichever it is.
#[derive(Debug)]
pub(crate) enum Fault {
    Read(io::Error),
    Format(u32),
    Damaged(String),
}

impl Fault {
    /// Not, or no longer, what was written.
    pub(crate) fn damaged(what: &str) -> Self {
        Self::Damaged(what.to_owned())
    }
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            ErrorKind::UnexpectedEof => Self::damaged("it ends too early"),
            _ => Self::Read(error),
        }
    }
}

/// Opens a file, checks all of it, and stands behind the version of the format; `what` it is not if
/// it begins otherwise. Beginning and
/// checksum are the same in every version, so that a damaged file is not taken for one of another.
pub(crate) fn open(path: &Path, magic: &[u8; 8], format: u32, what: &str) -> Result<Source, Fault> {
    let mut file = File::open(path)?;
    let mut begin = [0; 8];
    file.read_exact(&mut begin)?;
    if begin != *magic {
        return Err(Fault::Damaged(format!("it is no {what}")));
    }
    file.rewind()?;
    let len = file.metadata()?.len();
    let body = len.checked_sub(CHECKSUM).ok_or_else(|| Fault::damaged("it ends too early"))?;
    let mut summed = Summed { inner: io::sink(), crc: Crc::new() };
    io::copy(&mut BufReader::with_capacity(BUFFER, &file).take(body), &mut summed)?;
    file.seek(io::SeekFrom::Start(body))?;
    let mut checksum = [0; CHECKSUM as usize];
    file.read_exact(&mut checksum)?;
    if summed.crc.value() != u32::from_le_bytes(checksum) {
        return Err(Fault::damaged("its checksum does not agree: cut short or changed"));
    }
    file.seek(io::SeekFrom::Start(magic.len() as u64))?;
    let rest = body.saturating_sub(magic.len() as u64);
    let mut source = Source(BufReader::with_capacity(BUFFER, file).take(rest));
    match u32::from_le_bytes(source.array()?) {
        found if found == format => Ok(source),
        found => Err(Fault::Format(found)),
    }
}

/// A file that is being read, up to its checksum.
pub(crate) struct Source(io::Take<BufReader<File>>);

impl Source {
    /// The next bytes.
    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let mut bytes = [0; N];
        self.0.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// The length of a list whose elements take `size` bytes or more: no more than the file has.
    pub(crate) fn len(&mut self, size: usize) -> Result<usize, Fault> {
        let len: u64 = take(self)?;
        match len.checked_mul(size as u64) {
            Some(bytes) if bytes <= self.0.limit() => Ok(len as usize),
            _ => Err(Fault::damaged("it ends too early")),
        }
    }
}

impl Read for Source {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.0.read(bytes)
    }
}

/// A number of eight bytes.
pub(crate) trait Number: Sized {
    /// Little-endian.
    fn bytes(self) -> [u8; 8];
    /// The number of these bytes.
    fn of(bytes: [u8; 8]) -> Self;
}

impl Number for u64 {
    fn bytes(self) -> [u8; 8] {
        self.to_le_bytes()
    }
    fn of(bytes: [u8; 8]) -> Self {
        Self::from_le_bytes(bytes)
    }
}

impl Number for f64 {
    fn bytes(self) -> [u8; 8] {
        self.to_le_bytes()
    }
    fn of(bytes: [u8; 8]) -> Self {
        Self::from_le_bytes(bytes)
    }
}

/// Writes a number.
pub(crate) fn put(to: &mut (impl Write + ?Sized), number: impl Number) -> io::Result<()> {
    to.write_all(&number.bytes())
}

/// Reads a number.
pub(crate) fn take<N: Number>(from: &mut Source) -> Result<N, Fault> {
    Ok(N::of(from.array()?))
}

/// Writes a text.
pub(crate) fn put_text(to: &mut (impl Write + ?Sized), text: &str) -> io::Result<()> {
    put(to, text.len() as u64)?;
    to.write_all(text.as_bytes())
}

/// Reads a text.
pub(crate) fn take_text(from: &mut Source) -> Result<String, Fault> {
    let mut bytes = vec![0; from.len(1)?];
    from.0.read_exact(&mut bytes)?;
    String::from_utf8(bytes).map_err(|_| Fault::damaged("a text in it is not UTF-8"))
}

/// Writes a list of numbers.
pub(crate) fn put_list(to: &mut (impl Write + ?Sized), numbers: &[f64]) -> io::Result<()> {
    put(to, numbers.len() as u64)?;
    numbers.iter().try_for_each(|number| put(to, *number))
}

/// Reads a list of numbers.
pub(crate) fn take_list(from: &mut Source) -> Result<Vec<f64>, Fault> {
    (0..from.len(8)?).map(|_| take(from)).collect()
}

/// A writer that sums what it passes on.
struct Summed<W> {
    inner: W,
    crc: Crc,
}

impl<W: Write> Write for Summed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.crc.add(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// CRC-32 of IEEE 802.3: reflected polynomial 0xEDB88320, eight bytes at a time.
pub(crate) struct Crc(u32);

/// `TABLES[n][b]`: the sum of byte b followed by n zeros.
static TABLES: [[u32; 256]; 8] = {
    let mut tables = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut sum = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            sum = (sum >> 1) ^ (if sum & 1 == 1 { 0xEDB8_8320 } else { 0 });
            bit += 1;
        }
        tables[0][byte] = sum;
        byte += 1;
    }
    let mut n = 1;
    while n < 8 {
        let mut byte = 0;
        while byte < 256 {
            let before = tables[n - 1][byte];
            tables[n][byte] = (before >> 8) ^ tables[0][(before & 0xFF) as usize];
            byte += 1;
        }
        n += 1;
    }
    tables
};

impl Crc {
    pub(crate) fn new() -> Self {
        Self(!0)
    }

    pub(crate) fn add(&mut self, bytes: &[u8]) {
        let (chunks, rest) = bytes.as_chunks::<8>();
        for &[a, b, c, d, e, f, g, h] in chunks {
            let [a, b, c, d] = (self.0 ^ u32::from_le_bytes([a, b, c, d])).to_le_bytes();
            self.0 = [h, g, f, e, d, c, b, a]
                .iter()
                .zip(&TABLES)
                .fold(0, |sum, (byte, table)| sum ^ table[usize::from(*byte)]);
        }
        for byte in rest {
            self.0 = (self.0 >> 8) ^ TABLES[0][usize::from(self.0 as u8 ^ byte)];
        }
    }

    pub(crate) fn value(&self) -> u32 {
        !self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_ieee_802_3() {
        let sum = |parts: &[&str]| {
            let mut crc = Crc::new();
            parts.iter().for_each(|part| crc.add(part.as_bytes()));
            crc.value()
        };
        assert_eq!(sum(&[]), 0);
        assert_eq!(sum(&["123456789"]), 0xCBF4_3926);
        assert_eq!(sum(&["The quick brown fox jumps over the lazy dog"]), 0x414F_A339);
        assert_eq!(sum(&["The quick brown f", "ox jumps", " over the lazy dog"]), 0x414F_A339);
    }
}
