//! What encoder, decoder and muxer share: making elements, linking them, receiving errors, and
//! stopping a pipeline without ever blocking on it.
//!
//! Contract: nothing here panics on what a plugin does or lacks. [`Running`] owns a pipeline;
//! when it is dropped the pipeline is stopped, and if stopping takes longer than [`TEARDOWN`] (a
//! stuck driver, an encoder that never returns) the pipeline is left to a thread of its own and a
//! warning is logged: a leak is better than a daemon that hangs.

use std::fmt;
use std::sync::mpsc;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread;
use std::time::Duration;

use gstreamer as gst;
use gstreamer::glib;
use gstreamer::prelude::*;
use thiserror::Error;

/// How long stopping a pipeline may hold up its owner.
pub(crate) const TEARDOWN: Duration = Duration::from_secs(2);

/// GStreamer could not be started: its libraries are missing or do not fit. Nothing in this crate
/// works then.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("starting GStreamer: {0}")]
pub struct InitError(String);

/// Starts GStreamer. Safe to call any number of times from any thread; only the first call does
/// anything. Every entry point of this crate calls it.
///
/// # Errors
/// [`InitError`], the same one every time.
pub fn init() -> Result<(), InitError> {
    static RESULT: OnceLock<Result<(), InitError>> = OnceLock::new();
    RESULT
        .get_or_init(|| gst::init().map_err(|error| InitError(error.to_string())))
        .clone()
}

/// What GStreamer calls itself: `GStreamer 1.20.3`.
pub fn version() -> String {
    match init() {
        Ok(()) => gst::version_string().to_string(),
        Err(error) => error.to_string(),
    }
}

/// Makes an element, or says that this machine has none of that name or that it would not start.
pub(crate) fn make(element: &str) -> Result<gst::Element, String> {
    let factory = gst::ElementFactory::find(element)
        .ok_or_else(|| format!("no GStreamer element {element} on this machine"))?;
    factory
        .create()
        .build()
        .map_err(|error| format!("making {element}: {error}"))
}

/// A `capsfilter` for `caps`.
pub(crate) fn caps_filter(caps: &gst::Caps) -> Result<gst::Element, String> {
    let filter = make("capsfilter")?;
    filter.set_property("caps", caps);
    Ok(filter)
}

/// Sets a property from text. `Ok(false)` if the element has no such property. The plugin may be of
/// another version than the one the text was written for, so every mismatch is an error, where
/// glib's own setter would panic.
pub(crate) fn set_property(element: &gst::Element, name: &str, text: &str) -> Result<bool, String> {
    let Some(spec) = element.find_property(name) else {
        return Ok(false);
    };
    let refused = || {
        let kind = spec.value_type();
        format!(
            "setting {name} of {} to {text:?}: expected a {kind}",
            element.name()
        )
    };
    if !spec.flags().contains(glib::ParamFlags::WRITABLE) {
        return Err(format!(
            "setting {name} of {}: it cannot be written",
            element.name()
        ));
    }
    let value = glib::Value::deserialize_with_pspec(text, &spec).map_err(|_| refused())?;
    let number = value
        .get::<i32>()
        .map(i64::from)
        .or_else(|_| value.get::<u32>().map(i64::from))
        .unwrap_or_default();
    let range = spec
        .downcast_ref::<glib::ParamSpecInt>()
        .map(|spec| i64::from(spec.minimum())..=i64::from(spec.maximum()))
        .or_else(|| {
            let spec = spec.downcast_ref::<glib::ParamSpecUInt>()?;
            Some(i64::from(spec.minimum())..=i64::from(spec.maximum()))
        });
    if let Some(range) = range.filter(|range| !range.contains(&number)) {
        return Err(format!(
            "{}, {} to {}",
            refused(),
            range.start(),
            range.end()
        ));
    }
    element.set_property_from_value(name, &value);
    Ok(true)
}

/// Whether `element` has a signal of that name that can be sent without arguments and answers
/// nothing. (glib's own sender would panic where it has not.)
pub(crate) fn has_action(element: &gst::Element, signal: &str) -> bool {
    glib::subclass::SignalId::lookup(signal, element.type_()).is_some_and(|id| {
        let query = id.query();
        query.n_params() == 0 && query.return_type().type_() == glib::Type::UNIT
    })
}

/// What an element said when it failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Failure {
    /// The element's name in the pipeline.
    pub(crate) element: String,
    /// Its own words, in one line.
    pub(crate) reason: String,
    /// Whether it is about a device, which may come back.
    pub(crate) device: bool,
}

impl Failure {
    fn new(error: &gst::message::Error) -> Failure {
        let element = error
            .src()
            .map_or_else(|| "pipeline".into(), |source| source.name());
        let glib_error = error.error();
        let reason = match error.debug() {
            Some(detail) => {
                let detail = detail.lines().last().unwrap_or_default().to_owned();
                format!("{glib_error} ({detail})")
            }
            None => glib_error.to_string(),
        };
        Failure {
            element: element.into(),
            reason,
            device: glib_error.is::<gst::ResourceError>(),
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.element, self.reason)
    }
}

/// A mutex whose holder may have panicked (a caller's callback runs under some of them); the data
/// is plain enough to be used nevertheless.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits while `holds`, at most `limit`. The flag tells whether it still held at the end.
pub(crate) fn wait_while<'a, T>(
    changed: &Condvar,
    guard: MutexGuard<'a, T>,
    limit: Duration,
    holds: impl FnMut(&mut T) -> bool,
) -> (MutexGuard<'a, T>, bool) {
    let (guard, result) = changed
        .wait_timeout_while(guard, limit, holds)
        .unwrap_or_else(PoisonError::into_inner);
    (guard, result.timed_out())
}

/// A pipeline of linked elements that is stopped when this is dropped.
#[derive(Debug)]
pub(crate) struct Running {
    pipeline: gst::Pipeline,
    first_error: Arc<Mutex<Option<String>>>,
    stopped: bool,
}

/// What a pipeline says about itself.
#[derive(Debug)]
pub(crate) enum News {
    /// An element failed.
    Failed(Failure),
    /// Everything has arrived at the sink.
    Ended,
}

impl Running {
    /// Links `elements` one behind the other, tells `on_news` what happens (on the thread where it
    /// happens), and starts playing.
    pub(crate) fn start(
        elements: &[gst::Element],
        on_news: impl Fn(News) + Send + Sync + 'static,
    ) -> Result<Running, String> {
        let running = Running::prepare(elements, on_news)?;
        match running.pipeline.set_state(gst::State::Playing) {
            Ok(_) => Ok(running),
            Err(_) => Err(lock(&running.first_error)
                .take()
                .unwrap_or_else(|| "it would not start".into())),
        }
    }

    /// As [`Running::start`], but leaves the starting to the caller.
    pub(crate) fn prepare(
        elements: &[gst::Element],
        on_news: impl Fn(News) + Send + Sync + 'static,
    ) -> Result<Running, String> {
        let running = Running {
            pipeline: gst::Pipeline::new(),
            first_error: Arc::default(),
            stopped: false,
        };
        running
            .pipeline
            .add_many(elements)
            .map_err(|error| error.to_string())?;
        gst::Element::link_many(elements).map_err(|error| error.to_string())?;
        let bus = running.pipeline.bus().ok_or("the pipeline has no bus")?;
        bus.set_sync_handler({
            let first_error = running.first_error.clone();
            move |_, message| {
                // Nobody reads the bus, so nothing may stay on it.
                match message.view() {
                    gst::MessageView::Error(error) => {
                        let failure = Failure::new(error);
                        lock(&first_error).get_or_insert_with(|| failure.to_string());
                        on_news(News::Failed(failure));
                    }
                    gst::MessageView::Eos(_) => on_news(News::Ended),
                    _ => {}
                }
                gst::BusSyncReply::Drop
            }
        });
        Ok(running)
    }

    /// The pipeline itself.
    pub(crate) fn pipeline(&self) -> &gst::Pipeline {
        &self.pipeline
    }

    /// Stops the pipeline and says whether it did stop; files are closed then. Waits at most
    /// [`TEARDOWN`].
    pub(crate) fn stop(&mut self) -> bool {
        if self.stopped {
            return true;
        }
        let pipeline = self.pipeline.clone();
        let (done, stopped) = mpsc::sync_channel(1);
        let stopping = thread::Builder::new()
            .name("video-teardown".into())
            .spawn(move || {
                let _ = pipeline.set_state(gst::State::Null);
                // So that the owner's reference is the last, and callbacks are freed with it.
                drop(pipeline);
                let _ = done.send(());
            });
        // Without a thread to be had, nothing bounded can be done: leave it.
        self.stopped = stopping.is_ok() && stopped.recv_timeout(TEARDOWN).is_ok();
        self.stopped
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if !self.stop() {
            log::warn!(
                "a video pipeline did not stop within {} s; leaving it to itself",
                TEARDOWN.as_secs()
            );
        }
    }
}
