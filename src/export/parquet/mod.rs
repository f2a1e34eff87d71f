//! Apache Parquet, through the `parquet` crate without Arrow.

mod arrow_schema;
pub mod columns;
pub mod dataset;
pub mod file;
pub mod flat;
mod schema;
mod shelves;
