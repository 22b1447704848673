//! Turns a fuzzer's bytes into a session: either as they are, or as edits of the checked-in one.
//! Edits can sign what they have changed, so that what lies behind the checksums is reached too.

use session_archive::layout;

/// Files of the checked-in session, path and content.
pub fn fixture() -> Vec<(String, Vec<u8>)> {
    vec![
        (
            layout::MANIFEST.to_owned(),
            include_bytes!("../../tests/fixtures/v1/session.json").to_vec(),
        ),
        (
            layout::segment(0),
            include_bytes!("../../tests/fixtures/v1/segments/000000.mcap").to_vec(),
        ),
        (
            layout::rig_file("rig.toml"),
            include_bytes!("../../tests/fixtures/v1/rig/rig.toml").to_vec(),
        ),
    ]
}

/// Applies edits: each is a kind, a position and an argument, eight bytes in all.
pub fn edit(files: &mut Vec<(String, Vec<u8>)>, edits: &[u8]) {
    for e in edits.chunks_exact(8).take(64) {
        let which = usize::from(e[0] >> 4) % files.len();
        let content = &mut files[which].1;
        let at = u32::from_le_bytes([e[1], e[2], e[3], 0]) as usize % (content.len() + 1);
        let more = usize::from(u16::from_le_bytes([e[4], e[5]]));
        let end = (at + more).min(content.len());
        match e[0] & 0x0F {
            0..=4 => {
                for (byte, with) in content[at..].iter_mut().zip(&e[4..8]) {
                    *byte = *with;
                }
            }
            5 | 6 => {
                if let Some(byte) = content.get_mut(at) {
                    *byte ^= e[4];
                }
            }
            7 => drop(content.drain(at..end)),
            8 => drop(content.splice(at..at, std::iter::repeat_n(e[6], more % 600))),
            9 => {
                let part = content[at..end].to_vec();
                let to = usize::from(e[6]) * content.len() / 256;
                drop(content.splice(to..to, part));
            }
            10 => content.truncate(at),
            11 => content[at..end].fill(0),
            12 => sign(content),
            // Another segment, a copy of this one as it is now.
            13 if files.len() < 6 => {
                let number = files
                    .iter()
                    .filter(|f| f.0.starts_with("segments/"))
                    .count();
                let copy = files[1.min(files.len() - 1)].1.clone();
                files.push((layout::segment(number as u32), copy));
            }
            14 if files.len() > 1 => drop(files.remove(which)),
            _ => {}
        }
    }
}

/// Puts a right checksum over every chunk of a segment, or over a manifest.
fn sign(content: &mut [u8]) {
    const KEY: &[u8] = b"\n  \"crc32\": \"";
    if let Some(at) = content.windows(KEY.len()).rposition(|w| w == KEY) {
        let crc = format!("{:08x}", crc32fast::hash(&content[..at]));
        if let Some(old) = content.get_mut(at + KEY.len()..at + KEY.len() + 8) {
            old.copy_from_slice(crc.as_bytes());
        }
        return;
    }
    let mut at = 8;
    while let Some(head) = content.get(at..at + 9) {
        let length = u64::from_le_bytes(head[1..9].try_into().expect("eight bytes"));
        let Some(end) = usize::try_from(length)
            .ok()
            .and_then(|n| (at + 9).checked_add(n))
        else {
            return;
        };
        if head[0] == 6 && length > 40 && end <= content.len() {
            let crc = crc32fast::hash(&content[at + 49..end]);
            content[at + 33..at + 37].copy_from_slice(&crc.to_le_bytes());
        }
        at = end;
    }
}
