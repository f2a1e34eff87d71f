//! `SG_`, `SIG_VALTYPE_`, `SG_MUL_VAL_`: signals.

use super::model::{ByteOrder, MAX_LIST, MAX_SIGNALS, MAX_SIGNALS_PER_MESSAGE, Number, Signal};
use super::multiplex::{Mark, Selection};
use super::parser::Parser;
use super::statement::{Statement, Trouble, integer, real, short, unescaped};
use crate::frame::CAN_MAX_DATA;

impl<'a> Parser<'a> {
    /// "signal": `SG_ name multiplexer : start|size@order sign (factor,offset) [min|max] unit
    /// receiver`.
    pub fn signal(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Result<(), Trouble> {
        // Those of a message that was left out went with it.
        let Some(message) = self.open else {
            if !self.message_seen {
                return Err("it belongs to no message".to_owned());
            }
            while rest.next().is_some() {}
            return Ok(());
        };
        let name = rest.word("a name")?;
        let of = |trouble: Trouble| format!("signal {}: {trouble}", short(name));
        let mark = Mark::parse(rest.accept_word()).map_err(of)?;
        let mut signal = self.layout(rest, name, line).map_err(of)?;
        self.scaling(rest, &mut signal).map_err(of)?;
        signal.unit = unescaped(rest.accept_text().unwrap_or_default());
        skip_receivers(rest);
        self.check(message, &signal).map_err(of)?;

        let unique = self.signal_names.take(name);
        if unique != name {
            let text = || format!("the message has a signal {name} already; this one is {unique}");
            self.oddities.note(line, text);
        }
        signal.name = unique;
        signal.switch = mark.switch;
        let signals = &mut self.db.messages[message].signals;
        let index = signals.len();
        signals.push(signal);
        self.signals.entry((message, name)).or_insert(index);
        self.written.mark(message, index, mark);
        self.total_signals += 1;
        Ok(())
    }

    fn layout(
        &mut self,
        rest: &mut Statement<'_, 'a>,
        name: &str,
        line: u32,
    ) -> Result<Signal, Trouble> {
        rest.mark(':')?;
        let start: u16 = rest.integer("start bit")?;
        rest.mark('|')?;
        let length: u64 = rest.integer("length in bits")?;
        rest.mark('@')?;
        let word = rest.word("byte order and sign")?;
        let order = match word.as_bytes().first() {
            Some(b'1') => ByteOrder::Intel,
            Some(b'0') => ByteOrder::Motorola,
            _ => return Err(format!("{} is no byte order", short(word))),
        };
        let sign = if word.len() > 1 { Some(&word[1..]) } else { rest.accept_word() };
        let number = match sign {
            Some("-") => Number::Signed,
            Some("+") => Number::Unsigned,
            _ => {
                self.oddities.note(line, || format!("signal {name} has no sign; read as unsigned"));
                Number::Unsigned
            }
        };
        let length = match length {
            0 => return Err("it has no bits".to_owned()),
            1..=64 => u16::try_from(length).unwrap_or(64),
            _ => return Err(format!("{length} bits are too many for a number")),
        };
        Ok(Signal {
            name: String::new(),
            start,
            length,
            order,
            number,
            factor: 1.0,
            offset: 0.0,
            min: 0.0,
            max: 0.0,
            unit: String::new(),
            switch: false,
            gate: None,
            labels: None,
            comment: String::new(),
            line,
        })
    }

    fn scaling(&mut self, rest: &mut Statement<'_, 'a>, to: &mut Signal) -> Result<(), Trouble> {
        if rest.accept('(') {
            to.factor = rest.real("factor")?;
            rest.mark(',')?;
            to.offset = rest.real("offset")?;
            rest.mark(')')?;
        } else {
            let text = || "a signal has no factor and offset; read as 1 and 0".to_owned();
            self.oddities.note(to.line, text);
        }
        if to.factor == 0.0 {
            self.oddities.note(to.line, || "factor 0 makes no values; read as 1".to_owned());
            to.factor = 1.0;
        }
        if rest.accept('[') {
            let limit = |word: Option<&str>| word.and_then(real);
            let min = limit(rest.accept_word());
            rest.accept('|');
            let max = limit(rest.accept_word());
            rest.mark(']')?;
            if let (Some(min), Some(max)) = (min, max) {
                (to.min, to.max) = (min, max);
            } else {
                self.oddities.note(to.line, || "the range of a signal is no range; skipped".into());
            }
        }
        Ok(())
    }

    fn check(&mut self, message: usize, signal: &Signal) -> Result<(), Trouble> {
        let owner = &self.db.messages[message];
        let needs = signal.bytes();
        if needs > CAN_MAX_DATA {
            return Err(format!("it ends in byte {needs}, and no CAN frame has more than 64"));
        }
        if owner.signals.len() >= MAX_SIGNALS_PER_MESSAGE {
            return Err(format!("the message has {MAX_SIGNALS_PER_MESSAGE} signals already"));
        }
        if self.total_signals >= MAX_SIGNALS {
            return Err(format!("there are {MAX_SIGNALS} signals already"));
        }
        let (name, declared) = (&owner.name, owner.length);
        if needs > usize::from(declared) {
            self.oddities.note(signal.line, || {
                format!(
                    "a signal of {name} ends in byte {needs}, but the message has {declared}; it \
                     is decoded from frames that are long enough"
                )
            });
        }
        Ok(())
    }

    /// "signal_extended_value_type": SIG_VALTYPE_ id name ':' type; 1 is a 32-bit, 2 a 64-bit float.
    pub fn value_type(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Result<(), Trouble> {
        let Some((message, index)) = self.find_signal(rest)? else { return Ok(()) };
        rest.accept(':');
        let kind: u32 = rest.integer("value type")?;
        let signal = &mut self.db.messages[message].signals[index];
        signal.number = match (kind, signal.length) {
            (0, _) => return Ok(()),
            (1, 32) => Number::Float32,
            (2, 64) => Number::Float64,
            (1 | 2, bits) => {
                let name = &signal.name;
                let text = || format!("{name} has {bits} bits, no float; it stays an integer");
                self.oddities.note(line, text);
                return Ok(());
            }
            _ => return Err(format!("value type {kind} is not known")),
        };
        Ok(())
    }

    /// "Extended multiplexing": SG_MUL_VAL_ id signal switch from-to, from-to;
    pub fn extended_multiplexing(&mut self, rest: &mut Statement<'_, 'a>) -> Result<(), Trouble> {
        let Some((message, index)) = self.find_signal(rest)? else { return Ok(()) };
        let name = rest.word("the name of a switch")?;
        let Some(&switch) = self.signals.get(&(message, name)) else {
            return Err(format!("the message has no signal {}", short(name)));
        };
        let mut ranges = Vec::new();
        while let Some(word) = rest.accept_word() {
            let (from, to) = word.split_once('-').unwrap_or((word, word));
            let ends = integer(from).zip(integer(to));
            let ends =
                ends.and_then(|(a, b)| Some((u64::try_from(a).ok()?, u64::try_from(b).ok()?)));
            match ends {
                Some((a, b)) if a <= b => ranges.push((a, b)),
                _ => return Err(format!("{} is no range", short(word))),
            }
            rest.accept(',');
        }
        if ranges.is_empty() {
            return Err("it names no values".to_owned());
        }
        self.total_ranges += ranges.len();
        if self.total_ranges > MAX_LIST {
            return Err(format!("there are {MAX_LIST} ranges already"));
        }
        self.written.select(message, index, Selection { switch, ranges });
        Ok(())
    }

    /// The message and signal that a statement is about; `None` when they were refused before.
    pub fn find_signal(
        &self,
        rest: &mut Statement<'_, 'a>,
    ) -> Result<Option<(usize, usize)>, Trouble> {
        let raw: u32 = rest.integer("identifier")?;
        let name = rest.word("the name of a signal")?;
        let Some(message) = self.find(raw)? else {
            while rest.next().is_some() {}
            return Ok(None);
        };
        if let Some(&index) = self.signals.get(&(message, name)) {
            return Ok(Some((message, index)));
        }
        let message = &self.db.messages[message].name;
        Err(format!("message {message} has no signal {}", short(name)))
    }
}

fn skip_receivers(rest: &mut Statement<'_, '_>) {
    while rest.accept_word().is_some() && rest.accept(',') {}
}
