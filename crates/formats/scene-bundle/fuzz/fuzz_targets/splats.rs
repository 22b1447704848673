//! The output `splats` with any bytes as its files, and the right hashes of them: it is read, or
//! refused with an error.

#![no_main]

use std::fs;

use libfuzzer_sys::fuzz_target;
use scene_bundle::outputs::splats;
use scene_bundle::{Scene, layout, outputs};
use serde_json::json;

const FILES: [&str; 3] = ["splats.json", "000.ply", "sky.npy"];
const RECORD: &str = r#"{"degree":0,"compensated":false,"background":{"sky":{"size":2}},
    "sectors":[{"min_m":[-9,-9,-9],"max_m":[9,9,9],"count":1,"file":"000.ply","blake3":"HASH",
    "views":[],"neighbors":[]}],"views":[],"training":{"preset":"fast","seed":0,"steps":1,
    "start_count":1,"exposure_model":"none","depth_error":null,"checks":[]}}"#;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else {
        return;
    };
    let hash = |bytes: &[u8]| blake3::hash(bytes).to_hex().to_string();
    // The record, the Gaussians behind their hash, or the sky.
    let files = match mode % 3 {
        0 => [data.to_vec(), Vec::new(), Vec::new()],
        1 => {
            let record = RECORD.replace("HASH", &hash(data)).into_bytes();
            [record, data.to_vec(), Vec::new()]
        }
        _ => [RECORD.as_bytes().to_vec(), Vec::new(), data.to_vec()],
    };
    let mut named: Vec<(&str, &Vec<u8>)> = FILES.into_iter().zip(&files).collect();
    named.sort();
    let mut lines = String::new();
    let mut entries = Vec::new();
    for (name, bytes) in &named {
        lines += &format!("{} {} {name}\n", hash(bytes), bytes.len());
        entries.push(json!({"path": name, "bytes": bytes.len(), "blake3": hash(bytes)}));
    }
    let hash_of_output = hash(lines.as_bytes());
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder
        .path()
        .join(layout::folder(outputs::SPLATS, &hash_of_output));
    fs::create_dir(&output).expect("a folder");
    for (name, bytes) in named {
        fs::write(output.join(name), bytes).expect("a file");
    }
    let manifest = json!({
        "format": "paws-scene",
        "version": 2,
        "provenance": {
            "session_id": "01890a5d-ac96-774b-bcce-b302099a8057",
            "handoff_blake3": "ab".repeat(32),
            "judgement": null,
            "rig": {"name": "chest", "revision": "B"},
            "program": "fuzz",
            "program_version": "1",
            "started_civil_ns": 0,
            "ended_civil_ns": null,
        },
        "outputs": {"splats": {
            "stage": "splats", "stage_version": 1, "settings": {}, "inputs": {}, "files": entries,
            "hash": hash_of_output,
        }},
    });
    fs::write(folder.path().join("scene.json"), manifest.to_string()).expect("a file");
    let scene = Scene::open(folder.path()).expect("a bundle");
    let reader = scene.output(outputs::SPLATS).expect("an output");
    let Ok(record) = splats::read(&reader) else {
        return;
    };
    for (number, sector) in record.sectors.iter().enumerate() {
        if let Ok(found) = splats::read_sector(&reader, &record, number) {
            assert_eq!(found.len(), sector.count);
            assert!(found.planes().iter().flatten().all(|v| v.is_finite()));
        }
    }
    let _ = splats::read_sky(&reader, &record);
    for view in 0..record.views.len() {
        let _ = splats::read_comparison(&reader, view);
    }
});
