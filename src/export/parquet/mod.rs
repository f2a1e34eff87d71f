//! Apache Parquet, through the `parquet` crate without Arrow.

pub mod columns;
pub mod dataset;
pub mod file;
mod schema;
mod shelves;
