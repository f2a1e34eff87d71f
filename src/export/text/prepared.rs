//! Names and texts of tables, escaped once: they stand in every row.

use crate::export::table::{Cell, Column, Table};

/// How a format writes names and texts.
pub trait Escape {
    /// What stands in front of the values of each row.
    fn head(table: &Table, out: &mut Vec<u8>);
    /// The name of a column, with what stands between it and its value.
    fn name(name: &str, out: &mut Vec<u8>);
    /// The name that the texts of a column's values go by.
    fn label_name(column: &Column) -> String {
        column.label_name()
    }
    /// A text of a value table.
    fn text(text: &str, out: &mut Vec<u8>);
}

/// The names and texts of one table.
pub struct Prepared {
    /// See [`Escape::head`].
    pub head: Vec<u8>,
    /// By column.
    pub columns: Vec<Named>,
}

/// The names and texts of one column.
pub struct Named {
    /// Its name.
    pub name: Vec<u8>,
    /// That of the texts of its values.
    label_name: Vec<u8>,
    /// Texts by their index, those that have come up.
    texts: Vec<Option<Box<[u8]>>>,
}

impl Named {
    /// What the texts of values go by, and the text of a cell, if it has one.
    #[inline]
    pub fn label<E: Escape>(&mut self, column: &Column, cell: Cell) -> Option<(&[u8], &[u8])> {
        let index = cell.label? as usize;
        let text = column.labels.as_ref()?.get(index)?;
        let Self { label_name, texts, .. } = self;
        if texts.len() <= index {
            texts.resize_with(index + 1, || None);
        }
        let place = texts.get_mut(index)?;
        let text = place.get_or_insert_with(|| written(|out| E::text(text, out)).into());
        Some((label_name, text))
    }
}

/// Those of all tables, by their number.
#[derive(Default)]
pub struct Tables(Vec<Option<Box<Prepared>>>);

impl Tables {
    /// Those of table number `number`.
    #[inline]
    pub fn of<E: Escape>(&mut self, number: u32, table: &Table) -> Option<&mut Prepared> {
        let number = number as usize;
        if self.0.len() <= number {
            self.0.resize_with(number + 1, || None);
        }
        Some(self.0.get_mut(number)?.get_or_insert_with(|| Prepared::new::<E>(table).into()))
    }
}

impl Prepared {
    fn new<E: Escape>(table: &Table) -> Self {
        let columns = table.columns.iter().map(|column| Named {
            name: written(|out| E::name(&column.name, out)),
            label_name: written(|out| E::name(&E::label_name(column), out)),
            texts: Vec::new(),
        });
        Self { head: written(|out| E::head(table, out)), columns: columns.collect() }
    }
}

fn written(write: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut out = Vec::new();
    write(&mut out);
    out
}
