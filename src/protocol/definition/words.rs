//! Compiles the numbers of a header or a prefix.

use std::ops::Range;
use std::sync::Arc;

use super::super::error::Fault;
use super::super::word::{Block, Quantity};
use super::values::{self, Tables};
use super::{BitsForm, Format, ValuesForm, WordForm};
use toml::Spanned;

/// Compiles words that follow each other from byte `at` on.
pub fn block(words: &[Spanned<WordForm>], at: usize, tables: &Tables) -> Result<Block, Fault> {
    let mut block = Block { end: at, quantities: Vec::new() };
    for spanned in words {
        let (word, span) = (spanned.get_ref(), spanned.span());
        let size = match word.kind.as_str() {
            "u8" => 1,
            "u16" => 2,
            "u32" => 4,
            other => {
                let text = format!("\"{other}\" cannot be in a header; expected u8, u16 or u32");
                return Err(Fault::at(span, text));
            }
        };
        let place = Place { at: block.end, size, word, tables };
        let shown = Shown {
            name: &word.name,
            hidden: word.hidden,
            format: word.format,
            values: word.values.as_ref(),
            label: word.label.as_deref(),
        };
        block.quantities.push(place.quantity(&shown, 0, place.bits(), &span)?);
        for bits in &word.bits {
            block.quantities.push(place.bit_field(bits)?);
        }
        block.end += size;
    }
    unique(&block.quantities, words)?;
    Ok(block)
}

fn unique(quantities: &[Arc<Quantity>], words: &[Spanned<WordForm>]) -> Result<(), Fault> {
    for (index, quantity) in quantities.iter().enumerate() {
        if quantities[..index].iter().any(|other| other.name == quantity.name) {
            let span = words.first().map_or(0..0, Spanned::span);
            let text = format!("the name \"{}\" is used twice; expected it once", quantity.name);
            return Err(Fault::at(span, text));
        }
    }
    Ok(())
}

/// A word and where it is.
struct Place<'a> {
    at: usize,
    size: usize,
    word: &'a WordForm,
    tables: &'a Tables,
}

/// How a number is shown.
struct Shown<'a> {
    name: &'a str,
    hidden: bool,
    format: Format,
    values: Option<&'a ValuesForm>,
    label: Option<&'a str>,
}

impl Place<'_> {
    fn bits(&self) -> u32 {
        match self.size {
            1 => 8,
            2 => 16,
            _ => 32,
        }
    }

    fn quantity(
        &self,
        shown: &Shown<'_>,
        shift: u32,
        width: u32,
        span: &Range<usize>,
    ) -> Result<Arc<Quantity>, Fault> {
        let values = values::resolve(shown.values, self.tables, "values", span)?;
        if shown.format == Format::Label && values.is_none() {
            let text = format!("\"{}\" is shown by its label; expected values for it", shown.name);
            return Err(Fault::at(span.clone(), text));
        }
        let label = shown.label.map_or_else(|| format!("{}_name", shown.name), str::to_owned);
        Ok(Arc::new(Quantity {
            name: values::name(shown.name, span)?,
            at: self.at,
            size: self.size,
            order: self.word.byte_order,
            shift,
            width,
            values,
            format: shown.format,
            label: values::name(&label, span)?,
            hidden: shown.hidden,
        }))
    }

    fn bit_field(&self, spanned: &Spanned<BitsForm>) -> Result<Arc<Quantity>, Fault> {
        let (bits, span) = (spanned.get_ref(), spanned.span());
        let (high, low) = bits.bits.split_once('-').unwrap_or((&bits.bits, &bits.bits));
        let range = high.trim().parse::<u32>().ok().zip(low.trim().parse::<u32>().ok());
        let Some((high, low)) = range.filter(|(high, low)| low <= high && *high < self.bits())
        else {
            let text = format!(
                "\"{}\" is not in \"{}\"; expected a bit like \"7\" or bits like \"3-0\", at most \
                 {}",
                bits.bits,
                self.word.name,
                self.bits() - 1
            );
            return Err(Fault::at(span, text));
        };
        let shown = Shown {
            name: &bits.name,
            hidden: bits.hidden,
            format: bits.format,
            values: bits.values.as_ref(),
            label: bits.label.as_deref(),
        };
        self.quantity(&shown, low, high - low + 1, &span)
    }
}
