//! Pseudorandom numbers that are identical on every machine and in every version: the mixing function of SplitMix64.
//!
//! G. L. Steele, D. Lea and C. H. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014,
//! <https://doi.org/10.1145/2660193.2660195>; the constants of `mix` are David Stafford's variant 13.

/// The amount by which the generator's state increases per number: 2^64 divided by the golden ratio, rounded to an odd integer.
const GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// The number of random bits in a fraction: the precision of a double.
const DRAWN_BITS: u32 = 53;

const fn mix(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Returns a random number that depends on all given numbers. For a single number, it is the first output of SplitMix64 with that number
/// as the seed. For several numbers, the seed is the sum of the last number and the result for all numbers before it.
pub fn drawn(from: &[f64]) -> u64 {
    from.iter().fold(0, |state: u64, number| mix(state.wrapping_add(bits(*number)).wrapping_add(GAMMA)))
}

/// Like [`drawn`], but returns a fraction from 0 to below 1, as numerator and denominator. The denominator is 2^53.
pub fn share(from: &[f64]) -> (u64, u64) {
    (drawn(from) >> (u64::BITS - DRAWN_BITS), 1 << DRAWN_BITS)
}

/// Returns the integer that represents a number. A whole number is represented by its value, so that -0 equals 0; any other number by its
/// bits.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a whole number of less than 63 bits"
)]
fn bits(number: f64) -> u64 {
    if number.fract() == 0.0 && number.abs() < 4e18 { number as i64 as u64 } else { number.to_bits() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_alone_gives_the_first_splitmix64_number() {
        // From the reference implementation, splitmix64.c by Sebastiano Vigna, with the state 1234567.
        assert_eq!(drawn(&[1_234_567.0]), 6_457_827_717_110_365_317);
        assert_eq!(drawn(&[0.0]), 0xe220_a839_7b1d_cdaf);
    }

    #[test]
    fn every_number_affects_the_draw_and_shares_are_below_one() {
        assert_ne!(drawn(&[7.0, 0.0]), drawn(&[7.0, 1.0]));
        assert_ne!(drawn(&[7.0, 0.0]), drawn(&[7.0]));
        assert_ne!(drawn(&[7.0, 0.5]), drawn(&[7.0, 0.25]));
        assert_eq!(drawn(&[-0.0]), drawn(&[0.0]));
        for index in 0..1_000 {
            let (part, whole) = share(&[7.0, f64::from(index)]);
            assert!(part < whole, "{part}");
        }
    }
}
