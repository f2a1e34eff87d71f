//! Other shapes than a table for each message.

pub mod frames;
pub mod long;
pub mod survey;
pub mod wide;

use crate::export::table::{Column, Kind, Table};

/// A column without unit and labels.
fn column(name: &str, kind: Kind) -> Column {
    Column { name: name.to_owned(), kind, ..Column::default() }
}

/// A column of few different texts.
fn texts(name: &str) -> Column {
    Column { few_values: true, ..column(name, Kind::Text) }
}

/// A table of many buses.
fn table(columns: Vec<Column>) -> Table {
    Table { columns, ..Table::default() }
}
