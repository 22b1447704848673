use std::cell::{Cell, RefCell};
use std::path::Path;
use std::rc::Rc;

use scene_bundle::{Provenance, RigRevision};
use serde_json::{Value, json};

use super::*;

/// Failure of a toy stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Failure {
    #[default]
    None,
    /// Fails before it writes anything.
    Immediate,
    /// Fails after its first file.
    HalfWay,
    /// Leaves a file unfinished, so that its first output cannot be committed though others are.
    Unfinished,
}

/// Concatenates its inputs and its setting into each of its outputs.
struct Toy {
    name: &'static str,
    version: u32,
    inputs: &'static [&'static str],
    outputs: &'static [&'static str],
    setting: String,
    failure: Failure,
    runs: Rc<Cell<usize>>,
}

impl Stage<str> for Toy {
    fn name(&self) -> &'static str {
        self.name
    }
    fn version(&self) -> u32 {
        self.version
    }
    fn inputs(&self) -> &'static [&'static str] {
        self.inputs
    }
    fn outputs(&self) -> &'static [&'static str] {
        self.outputs
    }
    fn settings(&self) -> Value {
        json!({ "setting": self.setting })
    }
    fn run(&self, work: &Work<'_, str>) -> Result<(), StageError> {
        self.runs.set(self.runs.get() + 1);
        if self.failure == Failure::Immediate {
            return Err("it was to fail".into());
        }
        let mut text = self.setting.clone();
        for input in self.inputs {
            text += "+";
            text += &match *input {
                "handoff" => work.source().to_owned(),
                input => String::from_utf8(work.read(input)?.read("text")?)?,
            };
        }
        for output in self.outputs {
            work.draft(output)
                .write("text", format!("{output}({text})").as_bytes())?;
            work.progress(1, 2);
            if self.failure == Failure::HalfWay {
                return Err("it was to fail half-way".into());
            }
        }
        if self.failure == Failure::Unfinished {
            drop(work.draft(self.outputs[0]).create("more")?);
        }
        work.note(format!("{} ran", self.name));
        if self.setting == "lossy" {
            work.record_loss("a frame");
        }
        Ok(())
    }
}

/// Three stages: `rig` of the hand-off, `odometry` of both with two outputs, `depth` of one of
/// these.
struct Bench {
    folder: tempfile::TempDir,
    settings: [String; 3],
    versions: [u32; 3],
    failure: [Failure; 3],
    source: String,
    force: bool,
}

const STAGES: [(&str, &[&str], &[&str]); 3] = [
    ("rig", &["handoff"], &["rig"]),
    (
        "odometry",
        &["handoff", "rig"],
        &["trajectory-causal", "keyframes"],
    ),
    ("depth", &["keyframes"], &["depth"]),
];

impl Bench {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().expect("a folder"),
            settings: ["a", "b", "c"].map(str::to_owned),
            versions: [1; 3],
            failure: [Failure::None; 3],
            source: "walk".to_owned(),
            force: false,
        }
    }

    fn path(&self) -> std::path::PathBuf {
        self.folder.path().join("bundle")
    }

    fn bundle(&self) -> Bundle {
        let provenance = Provenance {
            session_id: "s".to_owned(),
            handoff_blake3: "0".repeat(64),
            judgement: None,
            rig: RigRevision {
                name: "rig".to_owned(),
                revision: "1".to_owned(),
            },
            program: "test".to_owned(),
            program_version: "0".to_owned(),
            started_civil_ns: 0,
            ended_civil_ns: None,
        };
        Bundle::create_or_open(&self.path(), provenance).expect("a bundle")
    }

    /// Runs, and gives how often each stage ran.
    fn run_only(
        &self,
        from: Option<&str>,
        to: Option<&str>,
    ) -> (Result<Vec<Outcome>, PipelineError>, [usize; 3]) {
        let runs: [Rc<Cell<usize>>; 3] = Default::default();
        let stages = (0..3).map(|k| {
            let (name, inputs, outputs) = STAGES[k];
            let toy: Box<dyn Stage<str>> = Box::new(Toy {
                name,
                version: self.versions[k],
                inputs,
                outputs,
                setting: self.settings[k].clone(),
                failure: self.failure[k],
                runs: runs[k].clone(),
            });
            toy
        });
        let pipeline = Pipeline::new(stages.collect(), &["handoff"]).expect("a good table");
        let hash = blake3_of(&self.source);
        let sources = Sources {
            source: self.source.as_str(),
            hashes: BTreeMap::from([("handoff".to_owned(), hash)]),
        };
        let selection = Selection {
            from: from.map(str::to_owned),
            to: to.map(str::to_owned),
            force: self.force,
        };
        let bundle = self.bundle();
        let found = pipeline.run(
            &sources,
            &bundle,
            &selection,
            &observer::NoObserver,
            &Meter::STILL,
        );
        (found, runs.map(|r| r.get()))
    }

    fn run(&self) -> [usize; 3] {
        let (found, runs) = self.run_only(None, None);
        found.expect("a run without failure");
        runs
    }

    /// Content of every output.
    fn content(&self) -> BTreeMap<String, String> {
        let scene = self.bundle().scene();
        let outputs = scene.manifest().outputs.keys().cloned();
        let text = |name: String| {
            let text = scene.output(&name).expect("an output").read("text");
            (
                name,
                String::from_utf8(text.expect("a file")).expect("text"),
            )
        };
        outputs.map(text).collect()
    }

    /// Content of a bundle written in one run without failure.
    fn expected(&self) -> BTreeMap<String, String> {
        let mut fresh = Self::new();
        fresh.settings.clone_from(&self.settings);
        fresh.source.clone_from(&self.source);
        fresh.versions = self.versions;
        fresh.run();
        fresh.content()
    }
}

fn blake3_of(text: &str) -> String {
    // Placeholder for a hash: 64 digits that depend on the text.
    let sum = text.bytes().fold(7_u64, |sum, b| {
        sum.wrapping_mul(31).wrapping_add(u64::from(b))
    });
    format!("{sum:064x}")
}

#[test]
fn stages_that_are_up_to_date_do_not_run() {
    let bench = Bench::new();
    let (first, runs) = bench.run_only(None, None);
    let first = first.expect("a run");
    assert_eq!(runs, [1, 1, 1]);
    assert!(first.iter().all(|o| o.state == State::Ran));
    let content = bench.content();
    assert_eq!(content["depth"], "depth(c+keyframes(b+walk+rig(a+walk)))");

    let (second, runs) = bench.run_only(None, None);
    let second = second.expect("a run");
    assert_eq!(runs, [0, 0, 0]);
    for (before, after) in first.iter().zip(&second) {
        assert_eq!(after.state, State::UpToDate);
        assert_eq!(
            (&before.outputs, &before.report),
            (&after.outputs, &after.report)
        );
    }
    assert_eq!(second[0].report.notes, ["rig ran"]);
    assert_eq!(bench.content(), content);
}

#[test]
fn a_changed_setting_or_version_runs_the_stage_and_its_dependents() {
    let mut bench = Bench::new();
    bench.run();
    bench.settings[2] = "d".to_owned();
    assert_eq!(bench.run(), [0, 0, 1]);
    bench.settings[1] = "e".to_owned();
    assert_eq!(bench.run(), [0, 1, 1]);
    bench.settings[0] = "f".to_owned();
    assert_eq!(bench.run(), [1, 1, 1]);
    assert_eq!(bench.content(), bench.expected());
    // The same bytes come out of another version of the rig, so nothing after it changes.
    bench.versions[0] = 2;
    assert_eq!(bench.run(), [1, 0, 0]);
    bench.force = true;
    assert_eq!(bench.run(), [1, 1, 1]);
}

#[test]
fn a_changed_input_runs_the_stages_that_read_it() {
    let mut bench = Bench::new();
    bench.run();
    bench.source = "another walk".to_owned();
    assert_eq!(bench.run(), [1, 1, 1]);
    assert_eq!(bench.content(), bench.expected());
}

#[test]
fn an_output_with_missing_or_truncated_files_is_recomputed() {
    let bench = Bench::new();
    bench.run();
    let content = bench.content();
    let file_path = |output: &str, file: &str| {
        let scene = bench.bundle().scene();
        scene.output(output).expect("an output").file_path(file)
    };
    std::fs::remove_file(file_path("keyframes", "text")).expect("a file");
    assert_eq!(bench.run(), [0, 1, 0]);
    std::fs::write(file_path("rig", "text"), "").expect("a file");
    assert_eq!(bench.run(), [1, 0, 0]);
    assert_eq!(bench.content(), content);
}

#[test]
fn a_failure_affects_only_the_stage_in_progress() {
    for failure in [Failure::Immediate, Failure::HalfWay, Failure::Unfinished] {
        for (k, (name, _, outputs)) in STAGES.iter().enumerate() {
            let mut bench = Bench::new();
            bench.failure[k] = failure;
            let (found, runs) = bench.run_only(None, None);
            let error = found.expect_err("trouble");
            assert!(error.to_string().contains(name), "{error}");
            assert!(matches!(
                (&error, failure),
                (PipelineError::Bundle { .. }, Failure::Unfinished)
                    | (
                        PipelineError::Stage { .. },
                        Failure::Immediate | Failure::HalfWay
                    )
            ));
            assert_eq!(runs, std::array::from_fn(|i| usize::from(i <= k)));
            assert_eq!(no_drafts(&bench.path()), 0, "{failure:?} in stage {k}");
            // Its first output is the missing one.
            let content = bench.content();
            assert!(!content.contains_key(outputs[0]), "{failure:?} {content:?}");

            bench.failure[k] = Failure::None;
            assert_eq!(bench.run(), std::array::from_fn(|i| usize::from(i >= k)));
            assert_eq!(bench.content(), bench.expected());
        }
    }
}

/// Number of remaining draft folders.
fn no_drafts(path: &Path) -> usize {
    let entries = std::fs::read_dir(path).expect("a bundle");
    let names = entries.map(|e| e.expect("an entry").file_name());
    names
        .filter(|n| n.to_string_lossy().starts_with(".draft"))
        .count()
}

#[test]
fn a_failure_keeps_the_previous_outputs() {
    let mut bench = Bench::new();
    bench.run();
    let content = bench.content();
    bench.settings[1] = "new".to_owned();
    bench.failure[1] = Failure::HalfWay;
    assert!(bench.run_only(None, None).0.is_err());
    assert_eq!(bench.content(), content);
    bench.failure[1] = Failure::None;
    assert_eq!(bench.run(), [0, 1, 1]);
    assert_eq!(bench.content(), bench.expected());
}

#[test]
fn stages_are_chosen_by_name() {
    let mut bench = Bench::new();
    let error = |from, to| {
        let (found, runs) = bench.run_only(from, to);
        assert_eq!(runs, [0; 3]);
        found.expect_err("a wrong choice").to_string()
    };
    assert_eq!(
        error(Some("mapping"), None),
        "choosing stages: found \"mapping\", expected one of rig, odometry, depth"
    );
    assert_eq!(
        error(Some("depth"), Some("rig")),
        "choosing stages: depth comes after rig, expected the other order"
    );
    assert_eq!(
        error(Some("depth"), None),
        "beginning with stage depth: output keyframes is missing, expected it of stage odometry"
    );
    assert_eq!(bench.run_only(None, Some("odometry")).1, [1, 1, 0]);
    // Stages before the first are used as they are, changed settings or not.
    bench.settings[0] = "changed".to_owned();
    assert_eq!(bench.run_only(Some("depth"), Some("depth")).1, [0, 0, 1]);
    assert_eq!(bench.run_only(Some("odometry"), None).1, [0, 0, 0]);
    assert_eq!(bench.run(), [1, 1, 1]);
}

#[test]
fn losses_are_reported_whether_or_not_a_stage_runs() {
    let mut bench = Bench::new();
    bench.settings[1] = "lossy".to_owned();
    for state in [State::Ran, State::UpToDate] {
        let outcomes = bench.run_only(None, None).0.expect("a run");
        assert_eq!(outcomes[1].state, state);
        assert_eq!(outcomes[1].report.losses, ["a frame"]);
        assert!(outcomes[0].report.losses.is_empty());
    }
}

#[test]
fn a_table_that_contradicts_itself_is_refused() {
    let toy = |name, inputs, outputs| -> Box<dyn Stage<str>> {
        Box::new(Toy {
            name,
            version: 1,
            inputs,
            outputs,
            setting: String::new(),
            failure: Failure::None,
            runs: Rc::default(),
        })
    };
    let check = |stages, expected: &str| {
        let error = Pipeline::new(stages, &["handoff"])
            .err()
            .expect("wrong")
            .to_string();
        assert_eq!(
            error,
            format!("the table of stages is wrong: stage {expected}")
        );
    };
    check(
        vec![toy("a", &["b"], &["a"])],
        "a reads b, which no earlier stage writes",
    );
    check(vec![toy("a", &[], &[])], "a writes nothing");
    check(
        vec![toy("a", &[], &["A"])],
        "a writes \"A\", which is not a valid name of an output",
    );
    check(
        vec![toy("a", &[], &["a"]), toy("a", &[], &["b"])],
        "a is listed twice",
    );
    check(
        vec![toy("a", &[], &["a"]), toy("b", &["a"], &["handoff"])],
        "b writes handoff, which exists already",
    );
}

#[test]
fn progress_is_reported_in_order() {
    #[derive(Default)]
    struct Recorder(std::sync::Mutex<RefCell<Vec<String>>>);
    impl Recorder {
        fn record(&self, what: String) {
            self.0.lock().expect("recorder").borrow_mut().push(what);
        }
    }
    impl Observer for Recorder {
        fn begin(&self, stage: &str, number: usize, of: usize) {
            self.record(format!("{number}/{of} {stage}"));
        }
        fn progress(&self, done: u64, total: u64) {
            self.record(format!("{done}/{total}"));
        }
        fn end(&self, outcome: &Outcome) {
            self.record(format!("{:?} {}", outcome.state, outcome.outputs.len()));
        }
    }
    let bench = Bench::new();
    bench.run_only(None, Some("rig")).0.expect("a run");
    let stages = STAGES[..2].iter().map(|(name, inputs, outputs)| {
        let toy: Box<dyn Stage<str>> = Box::new(Toy {
            name,
            version: 1,
            inputs,
            outputs,
            setting: if *name == "rig" { "a" } else { "b" }.to_owned(),
            failure: Failure::None,
            runs: Rc::default(),
        });
        toy
    });
    let pipeline = Pipeline::new(stages.collect(), &["handoff"]).expect("a good table");
    let sources = Sources {
        source: "walk",
        hashes: BTreeMap::from([("handoff".to_owned(), blake3_of("walk"))]),
    };
    let recorder = Recorder::default();
    let selection = Selection::default();
    let meter = Meter::STILL;
    pipeline
        .run(&sources, &bench.bundle(), &selection, &recorder, &meter)
        .expect("a run");
    let recorder = recorder.0.into_inner().expect("recorder").into_inner();
    assert_eq!(
        recorder,
        [
            "1/2 rig",
            "UpToDate 1",
            "2/2 odometry",
            "1/2",
            "1/2",
            "Ran 2"
        ]
    );
}
