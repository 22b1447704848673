use std::fs;

use super::*;

const SECTOR: usize = 512;

/// A log as the kernel writes it.
#[derive(Default)]
struct Writer {
    bytes: Vec<u8>,
    count: u64,
}

impl Writer {
    fn put(&mut self, sector: u64, sectors: u64, flags: u64, mark: &str, data: &[u8]) {
        let words = [sector, sectors, flags, mark.len() as u64];
        let mut entry: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        entry.extend(mark.bytes());
        entry.resize(SECTOR, 0);
        self.bytes.extend(entry);
        self.bytes.extend(data);
        self.count += 1;
    }

    fn write(&mut self, sector: u64, flags: u64, fill: u8) {
        self.put(sector, 8, flags, "", &[fill; 8 * SECTOR]);
    }

    fn save(&self, path: &Path) {
        let words = [MAGIC, VERSION, self.count, SECTOR as u64];
        let mut head: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        head.resize(SECTOR, 0);
        head.extend(&self.bytes);
        fs::write(path, head).unwrap();
    }
}

struct Scratch(std::path::PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let folder = format!("vm-write-log-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn state(&self, log: &WriteLog, at: usize, torn: Option<Torn>) -> Vec<u8> {
        let (base, image) = (self.0.join("base"), self.0.join("image"));
        fs::write(&base, vec![9; 32 * SECTOR]).unwrap();
        log.crash_image(&base, &image, at, torn).unwrap();
        fs::read(&image).unwrap()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn example(scratch: &Scratch) -> WriteLog {
    let mut log = Writer::default();
    log.write(0, 0, 1);
    log.put(0, 0, FLUSH, "", &[]);
    log.put(0, 0, MARK, "durable:5", &[]);
    log.write(8, 0, 2);
    log.put(16, 8, DISCARD, "", &[]);
    log.put(0, 0, FLUSH, "", &[]);
    log.write(24, 0, 3);
    let path = scratch.0.join("log");
    log.save(&path);
    WriteLog::open(&path).unwrap()
}

#[test]
fn a_cut_keeps_what_is_in_front_of_it() {
    let scratch = Scratch::new("cut");
    let log = example(&scratch);
    assert_eq!(log.entries().len(), 7);
    assert_eq!(log.marks().collect::<Vec<_>>(), [(2, "durable:5")]);
    let firsts = |at| {
        let disk = scratch.state(&log, at, None);
        [0, 8, 16, 24].map(|sector| disk[sector * SECTOR])
    };
    assert_eq!(firsts(0), [9, 9, 9, 9]);
    assert_eq!(firsts(3), [1, 9, 9, 9]);
    assert_eq!(firsts(5), [1, 2, 0, 9]);
    assert_eq!(firsts(7), [1, 2, 0, 3]);
    assert_eq!(firsts(100), [1, 2, 0, 3]);
}

#[test]
fn a_torn_cache_holds_whole_grains_of_what_comes_before_the_next_flush() {
    let scratch = Scratch::new("torn");
    let log = example(&scratch);
    let (mut all, mut none, mut some) = (0, 0, 0);
    for seed in 0..64 {
        let disk = scratch.state(&log, 3, Some(Torn { seed, grain: 2048 }));
        assert_eq!(disk[0], 1);
        assert_eq!(
            disk[24 * SECTOR],
            9,
            "what is behind the flush was not written yet"
        );
        let grains = disk[8 * SECTOR..16 * SECTOR].chunks(2048);
        let written: Vec<bool> = grains
            .map(|grain| {
                assert!(grain.iter().all(|byte| *byte == grain[0]));
                grain[0] == 2
            })
            .collect();
        match written[..] {
            [true, true] => all += 1,
            [false, false] => none += 1,
            _ => some += 1,
        }
    }
    assert!(all > 5 && none > 5 && some > 15, "{all} {none} {some}");
}

#[test]
fn what_is_no_log_is_refused() {
    let scratch = Scratch::new("none");
    let path = scratch.0.join("log");
    fs::write(&path, [7; 4096]).unwrap();
    let message = WriteLog::open(&path).unwrap_err().to_string();
    assert!(
        message.contains("begins with 0x707070707070707"),
        "{message}"
    );
    // One that ends too early.
    let mut log = Writer::default();
    log.write(0, 0, 1);
    log.count = 3;
    log.save(&path);
    assert!(WriteLog::open(&path).is_err());
}
