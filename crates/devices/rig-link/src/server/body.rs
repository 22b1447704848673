//! Bodies of responses: bytes in memory, or pieces that are still being read.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use bytes::Bytes;
use hyper::body::{Frame, SizeHint};
use tokio::sync::mpsc::{self, Receiver, Sender};

/// Maximum number of pieces that wait to be sent.
const MAX_QUEUED_PIECES: usize = 2;

/// A body.
pub(super) enum Body {
    Whole(Option<Bytes>),
    /// Pieces; the number of remaining bytes, if known.
    Pieces(Receiver<io::Result<Bytes>>, Option<u64>),
}

impl Body {
    pub(super) fn empty() -> Self {
        Self::Whole(None)
    }

    pub(super) fn of(bytes: impl Into<Bytes>) -> Self {
        Self::Whole(Some(bytes.into()).filter(|b: &Bytes| !b.is_empty()))
    }

    /// A body of `length` bytes, if known, and the sender of its pieces. Sending fails after the
    /// client has disconnected. An error closes the connection, so that a part is never mistaken
    /// for the whole.
    pub(super) fn pieces(length: Option<u64>) -> (Self, Sender<io::Result<Bytes>>) {
        let (sender, receiver) = mpsc::channel(MAX_QUEUED_PIECES);
        (Self::Pieces(receiver, length), sender)
    }
}

impl hyper::body::Body for Body {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        match &mut *self {
            Self::Whole(bytes) => Poll::Ready(bytes.take().map(|b| Ok(Frame::data(b)))),
            Self::Pieces(receiver, left) => receiver.poll_recv(context).map(|piece| match piece {
                Some(piece) => Some(piece.map(|bytes| {
                    if let Some(left) = left {
                        *left = left.saturating_sub(bytes.len() as u64);
                    }
                    Frame::data(bytes)
                })),
                // The reader has ended without an error.
                None if left.is_some_and(|left| left > 0) => {
                    Some(Err(io::ErrorKind::UnexpectedEof.into()))
                }
                None => None,
            }),
        }
    }

    fn is_end_stream(&self) -> bool {
        match self {
            Self::Whole(bytes) => bytes.is_none(),
            Self::Pieces(_, left) => *left == Some(0),
        }
    }

    fn size_hint(&self) -> SizeHint {
        match self {
            Self::Whole(bytes) => {
                SizeHint::with_exact(bytes.as_ref().map_or(0, |b| b.len() as u64))
            }
            Self::Pieces(_, Some(left)) => SizeHint::with_exact(*left),
            Self::Pieces(_, None) => SizeHint::default(),
        }
    }
}
