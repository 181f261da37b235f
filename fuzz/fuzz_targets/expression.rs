//! Parses any text as each kind of expression: a number, a time, a truth value, the value of a variable and a formula.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| downbeat_scripts::try_expression(text));
