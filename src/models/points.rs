//! Points as text: a line each, of a number for every marker.
//!
//! Most of the time of a quick closure is here, so that a line of plain decimal numbers goes eight bytes
//! at a time: where a byte is no digit is found first, which leaves no number waiting for the end of the
//! one before. Every other line is read number by number.

use std::io;
use wide::u8x16;

/// Bytes that must follow the lines, of any value: numbers are read eight bytes at a time, and what is no
/// digit is looked for in 64.
pub const PADDING: usize = 64;

/// Columns of points, all in one piece.
pub struct Columns {
    numbers: Vec<f64>,
    count: usize,
    rows: usize,
}

impl Columns {
    /// No points yet of `count` columns.
    pub fn new(count: usize) -> Self {
        Self { numbers: Vec::new(), count, rows: 0 }
    }

    /// No points any more, and space for `rows`.
    pub fn clear(&mut self, rows: usize) {
        self.rows = 0;
        let size = self.count * rows;
        if self.numbers.len() < size {
            self.numbers.resize(size, 0.0);
        }
    }

    /// How many points there are.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The columns.
    pub fn parts(&self) -> Vec<&[f64]> {
        self.numbers
            .chunks_exact(self.stride().max(1))
            .take(self.count)
            .map(|column| &column[..self.rows])
            .collect()
    }

    /// Points of little-endian doubles, a point after the other.
    pub fn read_doubles(&mut self, bytes: &[u8]) {
        let size = 8 * self.count;
        self.clear(bytes.len() / size);
        self.rows = bytes.len() / size;
        let stride = self.stride().max(1);
        for (k, column) in self.numbers.chunks_exact_mut(stride).take(self.count).enumerate() {
            for (number, point) in column.iter_mut().zip(bytes.chunks_exact(size)) {
                let double = *point[8 * k..].first_chunk().expect("eight bytes");
                *number = f64::from_le_bytes(double);
            }
        }
    }

    fn stride(&self) -> usize {
        self.numbers.len() / self.count
    }

    /// Reads the points of `text`, whole lines up to `end` and [`PADDING`] after them; a blank line has
    /// none. `number` counts the lines, `markers` are what a line has numbers of.
    ///
    /// # Errors
    /// Line and what is wrong in it.
    pub fn read_lines(
        &mut self,
        text: &[u8],
        end: usize,
        number: &mut usize,
        markers: &[String],
    ) -> io::Result<()> {
        // A number and what ends it are two bytes at least.
        self.clear(end / (2 * self.count) + 1);
        let stride = self.stride();
        let mut marks = Marks::new(text, 0);
        let mut at = 0;
        while at < end {
            let numbers = &mut self.numbers[self.rows..];
            if let Some(next) = quick_line(text, at, &mut marks, numbers, stride) {
                at = next;
                self.rows += 1;
                *number += 1;
                continue;
            }
            let length = text[at..end].iter().position(|byte| *byte == b'\n');
            let line = &text[at..at + length.unwrap_or(end - at)];
            *number += 1;
            let wrong = |why: String| {
                let message = format!("standard input, line {number}: {why}");
                io::Error::new(io::ErrorKind::InvalidData, message)
            };
            let mut numbers = numbers.iter_mut().step_by(stride);
            let mut found = 0;
            for part in line.split(|byte| BLANKS.contains(byte)).filter(|part| !part.is_empty()) {
                let value = number_of(part).ok_or_else(|| {
                    wrong(format!("\"{}\" is no finite number", String::from_utf8_lossy(part)))
                })?;
                if let Some(number) = numbers.next() {
                    *number = value;
                }
                found += 1;
            }
            if found != 0 && found != self.count {
                let markers = markers.join(", ");
                return Err(wrong(format!("{found} numbers, and the markers are {markers}")));
            }
            self.rows += usize::from(found != 0);
            at += line.len() + 1;
            marks = Marks::new(text, at);
        }
        Ok(())
    }
}

/// What stands between numbers.
const BLANKS: [u8; 4] = *b" ,\t\r";

/// The double nearest to a decimal number, none if that is no finite number.
fn number_of(text: &[u8]) -> Option<f64> {
    let number = std::str::from_utf8(text).ok()?.parse::<f64>().ok()?;
    Some(number).filter(|number| number.is_finite())
}

/// As many bytes as a word has, where the digits are 0 to 9 and nothing else is.
macro_rules! word {
    ($number:ty, $text:expr) => {
        <$number>::from_le_bytes(*$text.first_chunk().expect("padding"))
            ^ <$number>::from_ne_bytes([b'0'; size_of::<$number>()])
    };
}

/// A bit for each byte that is no digit.
#[inline(always)]
fn no_digits(bytes: &[u8; 64]) -> u64 {
    let mut found = 0;
    for bytes in bytes.as_chunks().0.iter().rev() {
        let numbers = u8x16::from(*bytes) ^ u8x16::splat(b'0');
        // It saturates, and what is 10 or more sets the highest bit.
        found = found << 16 | u64::from(numbers.saturating_add(u8x16::splat(0x76)).to_bitmask());
    }
    found
}

/// The number that the eight digits of a [`word`] are.
fn eight_digits(word: u64) -> u64 {
    // Pairs of digits, then all of them.
    let pairs = 10 * word + (word >> 8);
    let low = (pairs & 0x0000_00ff_0000_00ff).wrapping_mul(0x000f_4240_0000_0064);
    let high = ((pairs >> 16) & 0x0000_00ff_0000_00ff).wrapping_mul(0x0000_2710_0000_0001);
    low.wrapping_add(high) >> 32
}

/// Where bytes are no digits, in order.
struct Marks<'a> {
    text: &'a [u8],
    at: usize,
    /// Those of the 64 bytes from `at` that have not been given.
    left: u64,
}

impl<'a> Marks<'a> {
    /// Those from byte `at` on.
    fn new(text: &'a [u8], at: usize) -> Self {
        let mut marks = Self { text, at, left: 0 };
        if at + 64 <= text.len() {
            marks.look();
        }
        marks
    }

    fn look(&mut self) {
        let bytes: &[u8; 64] = self.text[self.at..].first_chunk().expect("padding");
        self.left = no_digits(bytes);
    }

    /// The next; there must be a line break, or the text ends.
    #[inline(always)]
    fn next(&mut self) -> usize {
        while self.left == 0 {
            self.at += 64;
            self.look();
        }
        let mark = self.at + self.left.trailing_zeros() as usize;
        self.left &= self.left - 1;
        mark
    }
}

/// Powers of ten that are doubles exactly.
const TENS: [f64; 16] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// Reads a line of as many numbers as there are columns, to the first of each column of `stride` numbers,
/// and gives where the next line starts: digits with or without a point and a sign before them, no more than
/// 15, which are a whole number below 2⁵³, so that dividing it by a power of ten rounds once. None if
/// something else is there.
#[inline(always)]
fn quick_line(
    text: &[u8],
    mut at: usize,
    marks: &mut Marks,
    numbers: &mut [f64],
    stride: usize,
) -> Option<usize> {
    let mut column = 0;
    loop {
        let mut mark = marks.next();
        let mut sign = 1.0;
        if mark == at && text[mark] != b'.' {
            while mark == at && text[mark] == b' ' {
                at += 1;
                mark = marks.next();
            }
            if mark == at && text[mark] == b'-' {
                sign = -1.0;
                at += 1;
                mark = marks.next();
            }
        }
        let near: &[u8; 16] = text[at..].first_chunk()?;
        let whole = mark - at;
        if whole > 15 {
            return None;
        }
        let (mut length, mut fraction) = (whole, 0);
        if near[whole] == b'.' {
            mark = marks.next();
            length = mark - at;
            fraction = length - whole - 1;
        }
        // The digits as the last ones of a word, after zeros; those behind the point are a byte further on.
        let value = if fraction > 0 && length <= 9 {
            let (word, next) = (word!(u64, near), word!(u64, near[1..]));
            let behind = u64::MAX << (8 * whole);
            eight_digits((word ^ (word ^ next) & behind) << (8 * (9 - length)))
        } else {
            let point = usize::from(length > whole);
            let digits = length - point;
            if digits == 0 || length > 15 {
                return None;
            }
            let word = word!(u128, near);
            let (next, behind) = (word >> (8 * point), u128::MAX << (8 * whole));
            let word = (word ^ (word ^ next) & behind) << (8 * (16 - digits));
            100_000_000 * eight_digits(word as u64) + eight_digits((word >> 64) as u64)
        };
        numbers[column] = sign * (value as i64 as f64 / TENS[fraction & 15]);
        column += stride;
        at = mark + 1;
        let end = near[length];
        if column < numbers.len() {
            if !matches!(end, b' ' | b',' | b'\t') {
                return None;
            }
        } else if end == b'\n' {
            return Some(at);
        } else if end == b'\r' && text[at] == b'\n' {
            marks.next();
            return Some(at + 1);
        } else {
            return None;
        }
    }
}

/// Values as text.
#[derive(Default)]
pub struct Lines {
    text: Vec<u8>,
}

impl Lines {
    /// The `values`, a line each, with as many digits as give the same double back.
    pub fn of(&mut self, values: &[f64]) -> &[u8] {
        /// More than a line has bytes.
        const LONGEST: usize = 32;
        /// Numbers that are made before the first is moved: what was just written in pieces is slow to read as
        /// a whole.
        const BATCH: usize = 16;
        if self.text.len() < LONGEST * values.len() {
            self.text.resize(LONGEST * values.len(), 0);
        }
        let mut shortest: [_; BATCH] = std::array::from_fn(|_| zmij::Buffer::new());
        let mut at = 0;
        for values in values.chunks(BATCH) {
            let mut texts = [""; BATCH];
            for ((text, buffer), value) in texts.iter_mut().zip(&mut shortest).zip(values) {
                *text = buffer.format(*value);
            }
            for text in &texts[..values.len()] {
                let text = text.as_bytes();
                let (line, length) = (&mut self.text[at..at + LONGEST], text.len());
                // Sizes that are known are moved without a call; the two overlap.
                match length {
                    16.. => {
                        line[..16].copy_from_slice(&text[..16]);
                        line[length - 16..length].copy_from_slice(&text[length - 16..]);
                    }
                    8.. => {
                        line[..8].copy_from_slice(&text[..8]);
                        line[length - 8..length].copy_from_slice(&text[length - 8..]);
                    }
                    _ => line[..length].copy_from_slice(text),
                }
                line[length] = b'\n';
                at += length + 1;
            }
        }
        &self.text[..at]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The points of `text` in two columns and how many lines it has, or what is wrong.
    fn read(text: &str) -> Result<(Vec<Vec<f64>>, usize), String> {
        let mut columns = Columns::new(2);
        let mut number = 0;
        let padded = [text.as_bytes(), &[b'7'; PADDING]].concat();
        let markers = ["a".to_owned(), "b".to_owned()];
        let read = columns.read_lines(&padded, text.len(), &mut number, &markers);
        read.map_err(|error| error.to_string())?;
        Ok((columns.parts().iter().map(|part| part.to_vec()).collect(), number))
    }

    #[test]
    fn numbers_are_read_to_the_last_bit() {
        let numbers = [
            "0.15",
            "16.448",
            "1",
            ".5",
            "3.",
            "0.000123456789012",
            "123456789012345",
            "-0.25",
            "-0",
            "-.5",
            "1e-3",
            "2.5E+2",
            "0.1234567890123456789",
            "00000000000000000.5",
            "+4",
            "12345678",
            "123456789",
            "0.12345678",
            "0.123456789",
            "12345678.12345678",
            "9007199254740993.0",
            "0.9007199254740993",
            "9.007199254740993",
            "0.0000000000000001",
            "5e-324",
            "12345678.9",
        ];
        for (a, b) in numbers.iter().flat_map(|a| numbers.iter().map(move |b| (a, b))) {
            for (before, between, after) in [
                ("", " ", "\n"),
                ("", ",", "\r\n"),
                ("  ", ", ", " \n"),
                (",", "\t ", "\n\n"),
                ("\n", ",,", "\t\n"),
            ] {
                let text = format!("0.5 1.5\n{before}{a}{between}{b}{after}2.5,3.5\n");
                let (found, lines) = read(&text).unwrap();
                assert_eq!(lines, text.lines().count(), "{text:?}");
                let expected = [[0.5, a.parse().unwrap(), 2.5], [1.5, b.parse().unwrap(), 3.5]];
                for (found, expected) in found.iter().flatten().zip(expected.as_flattened()) {
                    assert_eq!(found.to_bits(), f64::to_bits(*expected), "{text:?}");
                }
            }
        }
        assert_eq!(read("").unwrap().1, 0);
        assert_eq!(read("\n \n").unwrap(), (vec![vec![], vec![]], 2));
    }

    #[test]
    fn many_lines_of_every_length_are_read() {
        for places in 0..20 {
            let number = |i: usize, scale: f64| {
                format!("{:.places$}", (0.5 + 0.618_033_988_7 * i as f64).fract() * scale)
            };
            let lines = (0..2000).map(|i| (number(i, 0.65), number(i, 123.0)));
            let text: String = lines.clone().map(|(a, b)| format!("{a} {b}\n")).collect();
            let (found, _) = read(&text).unwrap();
            for (i, (a, b)) in lines.enumerate() {
                assert_eq!(
                    [found[0][i], found[1][i]],
                    [a.parse::<f64>().unwrap(), b.parse().unwrap()]
                );
            }
        }
    }

    #[test]
    fn what_is_no_number_is_named_with_its_line() {
        for part in [".", "1.2.3", "nan", "inf", "abc", "1e999", "--1", "- 1", "1-2", "-", "é"] {
            let error = read(&format!("1 2\n\n3 {part}\n4 5\n")).unwrap_err();
            let first = part.split(' ').next().unwrap();
            assert!(error.contains(&format!("line 3: \"{first}\" is no finite number")), "{error}");
        }
        for (line, count) in [("1", 1), ("1 2 3", 3), ("1.5,2.5,3.5,", 3)] {
            let error = read(&format!("1 2\n{line}\n4 5\n")).unwrap_err();
            assert!(error.ends_with(&format!("line 2: {count} numbers, and the markers are a, b")));
        }
    }

    #[test]
    fn doubles_are_sorted_into_columns() {
        let mut columns = Columns::new(3);
        let doubles: Vec<u8> = (0..12u8).flat_map(|i| f64::from(i).to_le_bytes()).collect();
        columns.read_doubles(&doubles);
        assert_eq!(
            columns.parts(),
            [[0.0, 3.0, 6.0, 9.0], [1.0, 4.0, 7.0, 10.0], [2.0, 5.0, 8.0, 11.0]]
        );
        columns.read_doubles(&doubles[..24]);
        assert_eq!(columns.parts(), [[0.0], [1.0], [2.0]]);
    }

    #[test]
    fn lines_give_the_same_doubles_back() {
        let values = [
            0.0,
            -0.0,
            1.0,
            0.1,
            1.0 / 3.0,
            -2.0 / 3.0,
            1e-5,
            1.5e300,
            -5e-324,
            123_456.0,
            12.5,
            f64::MIN,
            f64::NAN,
            f64::NEG_INFINITY,
            1_234.567_8,
            0.000_123_4,
        ];
        let mut out = Lines::default();
        out.of(&[0.5; 100]);
        let lines: Vec<&str> = std::str::from_utf8(out.of(&values)).unwrap().lines().collect();
        assert_eq!(lines.len(), values.len());
        for (line, value) in lines.iter().zip(values) {
            let found: f64 = line.parse().unwrap();
            assert!(
                found.to_bits() == value.to_bits() || found.is_nan() && value.is_nan(),
                "{line}"
            );
        }
    }
}
