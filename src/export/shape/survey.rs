//! How often things repeat: what a table with a column for each element has to know beforehand.

use std::io;

use crate::export::TableWriter;
use crate::export::catalogue::{Catalogue, Plan};
use crate::export::table::Row;
use crate::frame::Timestamp;

/// So many elements of something that repeats get columns at most.
pub const MOST_ELEMENTS: u64 = 1024;

/// Counts the elements of what repeats, and writes nothing.
#[derive(Default)]
pub struct Survey {
    /// By number of the table; `None` for those where nothing repeats.
    plans: Vec<Option<Plan>>,
    lengths: Vec<u64>,
    row: Row,
}

impl Survey {
    /// For each table the most elements that one message has had: 1 where nothing repeats, 0 of
    /// tables without any row.
    pub fn lengths(&self) -> &[u64] {
        &self.lengths
    }
}

impl TableWriter for Survey {
    fn write(
        &mut self,
        catalogue: &Catalogue,
        number: u32,
        _: Timestamp,
        payload: &[u8],
    ) -> io::Result<()> {
        let index = number as usize;
        while self.plans.len() <= index {
            let next = u32::try_from(self.plans.len()).unwrap_or(u32::MAX);
            let repeats = catalogue.table(next).filter(|(_, table)| table.repeats);
            self.lengths.push(0);
            self.plans.push(repeats.map(|(plan, _)| plan));
        }
        let (Some(plan), Some(most)) = (self.plans.get(index), self.lengths.get_mut(index)) else {
            return Ok(());
        };
        let mut count = 0;
        match plan {
            Some(plan) => plan.rows(payload, &mut self.row, |_| count += 1),
            None => count = 1,
        }
        *most = count.min(MOST_ELEMENTS).max(*most);
        Ok(())
    }

    fn finish(&mut self, _: &Catalogue) -> io::Result<()> {
        Ok(())
    }

    fn files(&self) -> u64 {
        0
    }
}
