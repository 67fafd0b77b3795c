//! Every parser and every service fed with whatever a line, a file or a station may bring: nothing panics, nothing grows without bound,
//! and what is said back stays within what was asked.
//!
//! Each target has seeds (`seeds/NAME/`, things as they are really met) and, once something was found, `__fuzz__/NAME/crashes`; both are
//! replayed first. Then come random inputs, [bolero](https://docs.rs/bolero): each is fed as it is, and read as a list of edits to a seed
//! ([`edits`]), so that it gets past magic numbers, checksums and brackets.
//!
//! | | |
//! | --- | --- |
//! | `cargo test --profile ci -p flight-tests --test fuzz` | two seconds each |
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
