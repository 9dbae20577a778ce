//! tracker.rs: a source of comotion in Rust, with the standard library alone.
//!
//!     rustc -O tracker.rs -o tracker
//!
//! Each batch goes to standard output after its length (four bytes, little-endian). With the crate
//! `zenoh` (and `use zenoh::Wait`), `send` is one line:
//!
//!     let session = zenoh::open(config).wait()?;      // mode "client", connect to the router
//!     let publisher = session
//!         .declare_publisher("comotion/@v1/default/obs/rust-tracker")
//!         .encoding("application/msgpack;comotion.ObservationBatch/1")
//!         .congestion_control(zenoh::qos::CongestionControl::Drop)
//!         .wait()?;
//!     publisher.put(batch).wait()?;

use std::io::{self, Write};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const SOURCE: &str = "rust-tracker";

/// msgpack, as much as a batch needs; its own integers are big-endian, columns little-endian.
struct Map(Vec<u8>);

impl Map {
    fn of(fields: u16) -> Self {
        let mut map = Map(vec![0xde]);
        map.0.extend(fields.to_be_bytes());
        map
    }

    fn str(&mut self, text: &str) -> &mut Self {
        self.0.extend([0xd9, text.len() as u8]); // up to 255 bytes
        self.0.extend(text.as_bytes());
        self
    }

    fn int(&mut self, key: &str, value: u64) -> &mut Self {
        self.str(key).0.push(0xcf);
        self.0.extend(value.to_be_bytes());
        self
    }

    fn column<const B: usize>(&mut self, key: &str, numbers: impl Iterator<Item = [u8; B]>) -> &mut Self {
        let bytes: Vec<u8> = numbers.flatten().collect();
        self.str(key).0.push(0xc6);
        self.0.extend((bytes.len() as u32).to_be_bytes());
        self.0.extend(bytes);
        self
    }
}

fn encode(session: &str, seq: u64, stamp_ns: u64, ids: &[u64], positions: &[[f32; 3]]) -> Vec<u8> {
    let mut map = Map::of(10);
    map.str("schema").str("comotion.ObservationBatch/1");
    map.str("source").str(SOURCE);
    map.str("session").str(session);
    map.int("seq", seq);
    map.str("space").str("world");
    map.str("unit").str("m");
    map.int("dim", 3);
    map.int("stamp_ns", stamp_ns);
    map.column("ids", ids.iter().map(|id| id.to_le_bytes()));
    map.column("positions", positions.iter().flatten().map(|x| x.to_le_bytes()));
    map.0
}

fn send(batch: &[u8]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(&(batch.len() as u32).to_le_bytes())?;
    out.write_all(batch)?;
    out.flush()
}

fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64
}

/// The tracker: a box that swings above a floor.
fn main() {
    let session = format!("{:016x}", now_ns()); // 16 hex digits, new at each start
    let mut state = 1u32;
    let mut uniform = |reach: f32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        reach * (state as f32 / u32::MAX as f32 * 2.0 - 1.0)
    };
    let ids: Vec<u64> = (0..30).collect(); // never given to another feature
    let rest: Vec<[f32; 3]> = ids
        .iter()
        .map(|&id| [(); 3].map(|()| uniform(if id < 10 { 0.1 } else { 1.0 })))
        .collect();
    for seq in 0.. {
        let stamp_ns = now_ns(); // when the sensor saw it
        let shift = 0.4 * (stamp_ns as f64 % 1e12 * 1e-9).sin() as f32;
        let seen: Vec<[f32; 3]> = rest
            .iter()
            .enumerate()
            .map(|(k, &[x, y, z])| if k < 10 { [x + shift, y, z + 0.5] } else { [x, y, z] })
            .collect();
        if send(&encode(&session, seq, stamp_ns, &ids, &seen)).is_err() {
            return; // nobody listens any more
        }
        std::thread::sleep(Duration::from_millis(33));
    }
}
