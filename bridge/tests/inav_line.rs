//! The lines to an INAV, with a peer in this process that answers as the facts say.

#![allow(
    clippy::disallowed_methods,
    clippy::unwrap_used,
    reason = "real sockets run in real time; a test program fails where it stands"
)]

use bridge::autopilot::io::Input;
use bridge::io::endpoint::Endpoint;
use bridge::io::firmware::InavLine;
use msp::message::simulator::{SimulatorRequest, flag};
use msp::message::{Motor, SimulatorReply};
use msp::{Accept, Decoder, Direction, Framing, Message as _, command};
use sim::{Room, SimConfig, Simulator, VehicleConfig};
use std::collections::VecDeque;
use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};
use vehicle::{RingConfig, Timestamp};

type Heard = Arc<Mutex<Vec<SimulatorRequest>>>;

/// UART 2: takes states, tells motors at 75 %.
fn simulated(listener: TcpListener, heard: Heard) {
    let (mut stream, _) = listener.accept().unwrap();
    let mut decoder = Decoder::new(Accept::Requests);
    let mut buffer = [0; 512];
    while let Ok(n @ 1..) = stream.read(&mut buffer) {
        let mut input = &buffer[..n];
        let mut out = Vec::new();
        while let Some(frame) = decoder.decode(&mut input) {
            let mut payload = Vec::new();
            if frame.command == command::SIMULATOR {
                heard
                    .lock()
                    .unwrap()
                    .push(SimulatorRequest::parse(frame.payload).unwrap());
                SimulatorReply::default().emit(&mut payload);
            } else {
                assert_eq!(frame.command, command::MOTOR);
                let motors_us = [1750, 1750, 1750, 1750, 0, 0, 0, 0];
                Motor { motors_us }.emit(&mut payload);
            }
            let reply = Direction::Reply;
            msp::encode(frame.framing, reply, frame.command, &payload, &mut out).unwrap();
        }
        if stream.write_all(&out).is_err() {
            return;
        }
    }
}

fn listen() -> (TcpListener, Endpoint) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (listener, Endpoint::TcpClient(address))
}

#[test]
fn states_go_out_motors_come_in_and_the_flying_port_carries_msp() {
    let (sensors, sensors_at) = listen();
    let (uart, uart_at) = listen();
    let heard = Heard::default();
    let peer = thread::spawn({
        let heard = Arc::clone(&heard);
        move || simulated(sensors, heard)
    });
    let uart = thread::spawn(move || {
        let (mut stream, _) = uart.accept().unwrap();
        let mut question = [0; 6];
        stream.read_exact(&mut question).unwrap();
        stream.write_all(&question).unwrap();
    });

    let ring = RingConfig::built_in("tof32").unwrap();
    let room = Room::named("office").unwrap();
    let vehicle = VehicleConfig {
        outside_fc: true,
        ..VehicleConfig::new(room.home(), ring.clone())
    };
    let mut simulator = Simulator::new(SimConfig {
        vehicles: vec![vehicle],
        ..SimConfig::new(room, ring, 1)
    })
    .unwrap();
    let settle = Duration::from_millis(50);
    let mut line = InavLine::new(uart_at, sensors_at, settle);
    let mut inputs = VecDeque::new();
    let mut question = Vec::new();
    let request = Direction::Request;
    msp::encode(Framing::V1, request, command::ATTITUDE, &[], &mut question).unwrap();

    let (mut now, mut answered, mut opened) = (Timestamp::ZERO, false, false);
    let end = Instant::now() + Duration::from_secs(20);
    while (simulator.truth(0).position.z() > -0.5 || !answered) && Instant::now() < end {
        if !line.keeps_up() {
            continue;
        }
        now += sim::STEP;
        simulator.advance(now, &mut |_, _| {});
        line.exchange(now, &mut simulator, &mut inputs);
        while let Some(input) = inputs.pop_front() {
            match input {
                Input::FcOpened => {
                    opened = true;
                    line.write(&question);
                }
                Input::Fc(bytes) => answered |= bytes[..] == question[..],
                _ => {}
            }
        }
        thread::sleep(Duration::from_micros(300));
    }
    assert!(opened && answered, "opened {opened}, answered {answered}");
    let height_m = -simulator.truth(0).position.z();
    assert!(height_m >= 0.5, "motors at 75 % lift it: {height_m} m");
    assert!(simulator.truth(0).armed);
    drop(line);
    uart.join().unwrap();
    peer.join().unwrap();

    let heard = heard.lock().unwrap();
    let (last, states) = heard.split_last().unwrap();
    assert_eq!(
        last.flags & flag::ENABLE,
        0,
        "the last word ends the simulation"
    );
    assert!(
        states
            .iter()
            .all(|s| s.flags & flag::ENABLE != 0 && s.version == 2)
    );
    assert!(states.len() > 100, "{} states", states.len());
    let highest_cm = states.iter().map(|s| s.altitude_cm).max().unwrap();
    assert!(
        (30..=70).contains(&highest_cm),
        "it is told that it climbs: {highest_cm} cm"
    );
    // Standing: one g upwards.
    assert!(
        (900..1100).contains(&states[0].acc_mg[2]),
        "{:?}",
        states[0].acc_mg
    );
}
