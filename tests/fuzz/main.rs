//! Every parser and every service fed with whatever a line, a file or a station may bring: nothing panics, nothing grows without bound,
//! and what is said back stays within what was asked.
//!
//! Each target has seeds (`seeds/NAME/`: things as they are really met, and what once broke it), fed first. Then come random inputs: each is
//! fed as it is, and read as a list of edits to a seed ([`edits`]), so that it gets past magic numbers, checksums and brackets.
//!
//! In a plain test run the inputs are the same every time, so that a change is blamed only for what it did. Searching is asked for by any
//! variable of [bolero](https://docs.rs/bolero), which then draws fresh inputs:
//!
//! | | |
//! | --- | --- |
//! | `cargo test --profile ci -p flight-tests --test fuzz` | the same 20,000 inputs each time, or as many of them as two seconds hold |
//! | `BOLERO_RANDOM_TEST_TIME_MS=600000 cargo test ... --test fuzz ground` | one target for ten minutes |
//! | `BOLERO_RANDOM_ITERATIONS=10000000 ...` | so many inputs |
//! | `BOLERO_RANDOM_SEED=N ...` | the input that failed, as the failure names it |
//! | `cargo bolero test -p flight-tests --test fuzz ground` | guided by coverage (needs `cargo install cargo-bolero`) |

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test program prints its figures and fails where it stands"
)]

mod edits;
mod files;
mod flight;
mod ground;
mod lines;
mod mavlink;

/// A target: a name and what is done with bytes.
macro_rules! fuzz {
    ($(#[$doc:meta])* $name:ident, $target:expr) => {
        $(#[$doc])*
        #[test]
        fn $name() {
            let seeds = crate::edits::Seeds::of(stringify!($name));
            let target = $target;
            let mut runs = 0u64;
            for seed in seeds.iter() {
                target(seed);
                runs += 1;
            }
            if !std::env::vars_os().any(|(k, _)| k.to_string_lossy().starts_with("BOLERO_")) {
                for input in crate::edits::fixed_inputs() {
                    target(&input);
                    target(&seeds.edited(&input));
                    runs += 2;
                }
                println!("FIGURES fuzz {}", stringify!($name));
                println!("{runs} inputs, the same every time");
                println!("END");
                return;
            }
            let count = std::sync::atomic::AtomicU64::new(runs);
            bolero::check!()
                .with_test_time(core::time::Duration::from_secs(2))
                .with_max_len(512)
                .for_each(|input: &[u8]| {
                    target(input);
                    target(&seeds.edited(input));
                    count.fetch_add(2, std::sync::atomic::Ordering::Relaxed);
                });
            println!("FIGURES fuzz {}", stringify!($name));
            println!("{} inputs", count.into_inner());
            println!("END");
        }
    };
}
pub(crate) use fuzz;
