//! The official MCAP conformance files through our parser: every record is what the JSON beside
//! the file says. The files are not in this repository; the test is skipped where they are absent.

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;
use session_archive::mcap::{MAGIC, ParseError, Record, RecordIter};
use session_archive::scan::Scan;

/// Type and fields of a record, written as the JSON files write them.
type JsonRecord = (String, BTreeMap<String, Value>);

fn written(record: &Record<'_>) -> JsonRecord {
    fn map<K: ToString, V: ToString>(map: &BTreeMap<K, V>) -> Value {
        map.iter()
            .map(|(k, v)| (k.to_string(), v.to_string().into()))
            .collect::<serde_json::Map<_, _>>()
            .into()
    }
    fn bytes(bytes: &[u8]) -> Value {
        bytes.iter().map(|b| Value::from(b.to_string())).collect()
    }
    macro_rules! fields {
        ($of:expr; $($name:ident),*) => {
            vec![$((stringify!($name), Value::from($of.$name.to_string()))),*]
        };
    }
    let (name, mut fields) = match record {
        Record::Header(r) => ("Header", fields!(r; library, profile)),
        Record::Footer(r) => (
            "Footer",
            fields!(r; summary_start, summary_offset_start, summary_crc),
        ),
        Record::Schema(r) => ("Schema", fields!(r; id, name, encoding)),
        Record::Channel(r) => (
            "Channel",
            fields!(r; id, schema_id, topic, message_encoding),
        ),
        Record::Message(r) => (
            "Message",
            fields!(r; channel_id, sequence, log_time, publish_time),
        ),
        Record::ChunkIndex(r) => (
            "ChunkIndex",
            fields!(r; message_start_time, message_end_time, chunk_start_offset, chunk_length,
                message_index_length, compression, compressed_size, uncompressed_size),
        ),
        Record::Attachment(r) => (
            "Attachment",
            fields!(r; log_time, create_time, name, media_type),
        ),
        Record::AttachmentIndex(r) => (
            "AttachmentIndex",
            fields!(r; offset, length, log_time, create_time, data_size, name, media_type),
        ),
        Record::Statistics(r) => (
            "Statistics",
            fields!(r; message_count, schema_count, channel_count, attachment_count,
                metadata_count, chunk_count, message_start_time, message_end_time),
        ),
        Record::Metadata(r) => ("Metadata", fields!(r; name)),
        Record::MetadataIndex(r) => ("MetadataIndex", fields!(r; offset, length, name)),
        Record::SummaryOffset(r) => (
            "SummaryOffset",
            fields!(r; group_opcode, group_start, group_length),
        ),
        Record::DataEnd { data_section_crc } => (
            "DataEnd",
            vec![("data_section_crc", data_section_crc.to_string().into())],
        ),
        other => panic!("{other:?}"),
    };
    match record {
        Record::Schema(r) => fields.push(("data", bytes(r.data))),
        Record::Message(r) => fields.push(("data", bytes(r.data))),
        Record::Attachment(r) => fields.push(("data", bytes(r.data))),
        Record::Channel(r) => fields.push(("metadata", map(&r.metadata))),
        Record::Metadata(r) => fields.push(("metadata", map(&r.metadata))),
        Record::ChunkIndex(r) => {
            fields.push(("message_index_offsets", map(&r.message_index_offsets)));
        }
        Record::Statistics(r) => {
            fields.push(("channel_message_counts", map(&r.channel_message_counts)));
        }
        _ => {}
    }
    let fields = fields.into_iter().map(|(k, v)| (k.to_owned(), v));
    (name.to_owned(), fields.collect())
}

/// The records of a file: chunks opened, message indexes (which the JSON leaves out) checked
/// against the chunk before them.
fn records(file: &[u8]) -> Result<Vec<JsonRecord>, ParseError> {
    let inside = &file[MAGIC.len()..file.len() - MAGIC.len()];
    let mut all = Vec::new();
    let mut indexed: BTreeMap<u16, Vec<(u64, u64)>> = BTreeMap::new();
    for record in RecordIter::new(inside) {
        match record? {
            Record::Chunk(chunk) => {
                assert!(chunk.verify(), "checksum");
                indexed.clear();
                let mut records = chunk.iter();
                loop {
                    let offset = (chunk.records.len() - records.remaining()) as u64;
                    let Some(record) = records.next().transpose()? else {
                        break;
                    };
                    if let Record::Message(m) = &record {
                        let of_channel = indexed.entry(m.channel_id).or_default();
                        of_channel.push((m.log_time, offset));
                    }
                    all.push(written(&record));
                }
            }
            Record::MessageIndex(index) => {
                let expected = indexed.remove(&index.channel_id).unwrap_or_default();
                assert_eq!(index.records, expected);
            }
            record => all.push(written(&record)),
        }
    }
    Ok(all)
}

fn expected(path: &Path) -> Vec<JsonRecord> {
    let text = fs::read(path).expect("read the JSON");
    let json: Value = serde_json::from_slice(&text).expect("parse the JSON");
    let records = json["records"].as_array().expect("records");
    let fields = |r: &Value| -> BTreeMap<String, Value> {
        let fields = r["fields"].as_array().expect("fields").iter();
        fields
            .map(|f| (f[0].as_str().expect("name").to_owned(), f[1].clone()))
            .collect()
    };
    records
        .iter()
        .map(|r| (r["type"].as_str().expect("type").to_owned(), fields(r)))
        .collect()
}

/// Goes through any bytes with the scan; it must end and panic nowhere.
fn scan(bytes: &[u8]) {
    let mut scan = Scan::new(Arc::new(bytes.to_vec()), None, 0).expect("scan");
    while scan.next_item().expect("memory does not fail").is_some() {}
    assert!(scan.end().is_some());
}

fn mcap_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("list") {
        let path = entry.expect("entry").path();
        if path.is_dir() {
            found.extend(mcap_files(&path));
        } else if path.extension().is_some_and(|e| e == "mcap") {
            found.push(path);
        }
    }
    found.sort();
    found
}

#[test]
fn every_conformance_file_is_what_its_json_says() {
    let Some(folder) = test_data::shared("09_containers_video/mcap_conformance") else {
        return;
    };
    let files = mcap_files(&folder);
    let (mut count, mut types) = (0, BTreeMap::new());
    for path in &files {
        let bytes = fs::read(path).expect("read");
        let found = records(&bytes).unwrap_or_else(|e| panic!("{e}: {}", path.display()));
        assert_eq!(
            found,
            expected(&path.with_extension("json")),
            "{}",
            path.display()
        );
        scan(&bytes);
        count += 1;
        for (name, _) in found {
            *types.entry(name).or_insert(0) += 1;
        }
    }
    eprintln!("{count} files; {types:?}");
    assert_eq!(count, 416);
    assert_eq!(types.len(), 13, "{types:?}");
}

/// Chunks with a compression that we do not read are refused by name.
#[test]
fn compressed_chunks_of_others_are_a_clear_error() {
    let Some(folder) = test_data::shared("09_containers_video/rosbag2") else {
        return;
    };
    let files = mcap_files(&folder);
    assert!(!files.is_empty());
    for path in files {
        let bytes = fs::read(&path).expect("read");
        scan(&bytes);
        match records(&bytes) {
            Ok(records) => assert!(!records.is_empty()),
            Err(e) => {
                assert!(matches!(e, ParseError::Compressed(_)), "{e}");
                assert!(e.to_string().contains("does not read"), "{e}");
            }
        }
    }
}
