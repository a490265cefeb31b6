//! Drawing: charts of curves over time, as PNG and SVG.
//!
//! | module | contents |
//! |---|---|
//! | [`picture`] | shapes and letters, drawn as PNG or as SVG |
//! | [`timeline`] | values over time in fixed memory, however long they last |
//! | [`chart`] | panels of curves over a common axis of time |

#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod chart;
pub mod picture;
pub mod timeline;
