//! Broken and hostile files: readers return Gaussians or an error that says what was found, and
//! need no more memory than the file or the given maximum has.

use std::io::Write;

use counting_allocator::{CountingAllocator, peak_of};
use gaussians::files::{FileError, SplatFile, dot_splat, ply, spz};
use gaussians::{Splat, Splats};

/// Maximum number of Gaussians that the readers are given.
const MAX: usize = 1000;
/// Changed files of each format.
const CASES: u64 = 5000;
/// Memory beyond twice the file: `MAX` Gaussians of degree 3 as planes that grow, and columns.
const ROOM: usize = MAX * 59 * 4 * 3 + MAX * 65 + 10_000;

type Reader = fn(&[u8], usize) -> Result<SplatFile, FileError>;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn splats(degree: usize) -> Splats {
    let mut splats = Splats::empty(degree).unwrap();
    for i in 0..20_u64 {
        let bell = |k: u64| counter_random::bell(1, k, i) as f32;
        let splat = Splat {
            position_m: [bell(0), bell(1), bell(2)],
            rotation_wxyz: [1.0 + bell(3).abs(), bell(4), bell(5), bell(6)],
            ..Splat::sphere(0.1, [bell(7), bell(8), bell(9)])
        };
        splats.push(&splat).unwrap();
    }
    splats
}

fn gzip(plain: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(plain).unwrap();
    encoder.finish().unwrap()
}

/// Version 3 of `.spz` before compression: header, and columns of any bytes.
fn plain_spz(count: u32, degree: u8, columns: usize) -> Vec<u8> {
    let mut plain = Vec::new();
    plain.extend(0x5053_474e_u32.to_le_bytes());
    plain.extend(3_u32.to_le_bytes());
    plain.extend(count.to_le_bytes());
    plain.extend([degree, 12, 0, 0]);
    plain.extend((0..columns).map(|i| (i * 37 % 251) as u8));
    plain
}

/// A file with up to four edits.
fn edited(original: &[u8], case: u64) -> Vec<u8> {
    let mut bytes = original.to_vec();
    let random = |k: u64| counter_random::bits(5, k, case) as usize;
    for k in (1..2 + random(0) as u64 % 4).map(|k| 8 * k) {
        if bytes.is_empty() {
            break;
        }
        // Half of the edits are in the header.
        let reach = match random(k) % 2 {
            0 => bytes.len().min(600),
            _ => bytes.len(),
        };
        let at = random(k + 1) % reach;
        let end = (at + random(k + 2) % 40).min(bytes.len());
        match random(k + 3) % 9 {
            0 => bytes[at] = random(k + 4) as u8,
            1 => bytes[at] ^= 1 << (random(k + 4) % 8),
            2 => drop(bytes.drain(at..end)),
            3 => drop(bytes.splice(at..at, [random(k + 4) as u8; 3])),
            4 => bytes.truncate(at),
            5 => bytes[at..end].fill(0),
            6 => {
                let part = bytes[at..end].to_vec();
                let to = random(k + 4) % bytes.len();
                drop(bytes.splice(to..to, part));
            }
            7 => {
                let extremes = [f32::NAN, f32::INFINITY, f32::MAX, -1.0, 0.0];
                let word = extremes[random(k + 4) % 5].to_le_bytes();
                for (byte, with) in bytes[at..].iter_mut().zip(word) {
                    *byte = with;
                }
            }
            _ => {
                // A number of a text.
                let digit = bytes[at..].iter().position(u8::is_ascii_digit);
                let number = ["4294967295", "99999999999999999999", "-1", "0", "1e9"];
                let text = number[random(k + 4) % 5].bytes();
                if let Some(digit) = digit {
                    drop(bytes.splice(at + digit..at + digit + 1, text));
                }
            }
        }
    }
    bytes
}

/// Reads a file within bounds of memory; whether it was refused.
fn is_refused(name: &str, read: Reader, bytes: &[u8]) -> bool {
    let (result, peak) = peak_of(|| read(bytes, MAX));
    assert!(
        peak <= 2 * bytes.len() + ROOM,
        "{name}: {peak} bytes of memory for a file of {}",
        bytes.len()
    );
    match result {
        Ok(file) => {
            assert!(file.splats.len() <= MAX, "{name}");
            let mut values = file.splats.planes().iter().flatten();
            assert!(values.all(|value| value.is_finite()), "{name}");
            false
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            true
        }
    }
}

#[test]
fn edited_files_are_read_or_refused_within_their_memory() {
    let plain = plain_spz(20, 2, 20 * 44);
    let formats: [(&str, Reader, Vec<u8>); 4] = [
        ("ply", ply::read, ply::write(&splats(2), true)),
        ("splat", dot_splat::read, dot_splat::write(&splats(0))),
        ("spz", spz::read, spz::write(&splats(2), true).unwrap()),
        ("old spz", spz::read, gzip(&plain)),
    ];
    for (name, read, bytes) in formats {
        assert!(!is_refused(name, read, &bytes), "{name}");
        let refused = (0..CASES)
            .filter(|case| {
                // What lies behind the checksum of gzip is reached, too.
                let changed = match name == "old spz" && case % 2 == 0 {
                    true => gzip(&edited(&plain, *case)),
                    false => edited(&bytes, *case),
                };
                is_refused(name, read, &changed)
            })
            .count();
        println!("{name}: {refused} of {CASES} refused");
        assert!((500..5000).contains(&refused), "{name}: {refused}");
    }
}

#[test]
fn announced_numbers_are_no_memory() {
    let text = |count: &str| {
        let header = ply::write(&splats(0), false);
        let end = header.windows(10).position(|w| w == b"end_header").unwrap() + 11;
        let header = String::from_utf8_lossy(&header[..end]).into_owned();
        header
            .replace("vertex 20", &format!("vertex {count}"))
            .into_bytes()
    };
    for count in ["1000", "4294967295", "18446744073709551616", "-5"] {
        assert!(is_refused(count, ply::read, &text(count)));
    }
    // Properties without end, and a header without end.
    let long = "property float x\n".repeat(1_000_000);
    let long = format!("ply\nformat binary_little_endian 1.0\nelement vertex 1\n{long}");
    assert!(is_refused("properties", ply::read, long.as_bytes()));
    // Streams that are longer than their header says, and shorter.
    let bomb = gzip(&plain_spz(10, 0, 64 << 20));
    assert!(bomb.len() < 1 << 20 && is_refused("bomb", spz::read, &bomb));
    let short = gzip(&plain_spz(MAX as u32, 3, 10));
    assert!(is_refused("short", spz::read, &short));
    let mut many = spz::write(&splats(0), false).unwrap();
    many[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(is_refused("many", spz::read, &many));
}
