//! Robots that refuse correctly, but with a wrong error code. Checks recognise a refusal by its code, so one wrong code may break several
//! checks.

use super::{Mutant, mutant, recode};

/// Returns the robots with a wrong error code that quick checks detect.
pub fn all() -> Vec<Mutant> {
    vec![
        mutant("`late` has another code", &["late", "late-by-little"], |_, passing| recode(passing, "late")),
        mutant(
            "`out_of_range` has another code",
            &["range", "script-range", "repeated-refusal"],
            |_, passing| recode(passing, "out_of_range"),
        ),
        mutant("`off_granularity` has another code", &["granularity", "script-range"], |_, passing| {
            recode(passing, "off_granularity")
        }),
        mutant("`too_many_steps` has another code", &["one-step-too-many"], |_, passing| {
            recode(passing, "too_many_steps")
        }),
        mutant("`overlap` has another code", &["overlap"], |_, passing| recode(passing, "overlap")),
        mutant("`unknown_device` has another code", &["unknown-device"], |_, passing| {
            recode(passing, "unknown_device")
        }),
        mutant(
            "`busy` has another code",
            &["queue", "session", "session-reading", "session-stop"],
            |_, passing| recode(passing, "busy"),
        ),
        mutant(
            "`cancelled` has another code",
            &[
                "unsupported-control-type",
                "unknown-control-type",
                "cancel-pending",
                "cancel-from",
                "cancel-running",
                "home",
                "take-back",
            ],
            |_, passing| recode(passing, "cancelled"),
        ),
        mutant(
            "`malformed` has another code",
            &[
                "script-order",
                "content-hash",
                "malformed-line",
                "wrong-type",
                "not-utf8",
                "bad-numbers",
                "long-strings",
                "huge-line",
                "duplicate-keys",
            ],
            |_, passing| recode(passing, "malformed"),
        ),
    ]
}

/// Returns the robot whose wrong error code is found only by waiting for the end of leases.
pub fn lease() -> Vec<Mutant> {
    vec![mutant(
        "`link_lost` has another code",
        &[
            "lease-pending",
            "lease-running",
            "lease-silence",
            "lease-queued",
            "lease-step",
            "lease-noise",
            "lease-link-down",
            "lease-two-links",
            "lease-stranger",
        ],
        |_, passing| recode(passing, "link_lost"),
    )]
}
