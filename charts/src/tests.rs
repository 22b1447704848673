//! What every picture promises, over many kinds of data.
