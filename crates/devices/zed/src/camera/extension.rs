//! Registers and flash of the camera's video chip, through its UVC extension unit.
//!
//! One control carries everything: a request is written to it, and the answer read from it a little
//! later. Building and reading the bytes is pure; [`Unit`] is the I/O, by [`v4l2::Camera`]. Layout
//! and waits: zed-open-capture, `videocapture.cpp` at 9373915. **Never run on a real camera.**

use std::time::Duration;

/// Number of the extension unit.
pub const UNIT: u8 = 0x04;
/// The control in it.
const SELECTOR: u8 = 0x02;
/// Length of the control on USB 3. On USB 2 it is 64.
const CONTROL_BYTES: usize = 384;
/// Between a request and its answer.
const ANSWER_AFTER: Duration = Duration::from_millis(2);

/// Where the flash holds the serial number.
const SERIAL_AT: u32 = 0x18000;
/// How much of it is read there.
const SERIAL_BYTES: u16 = 64;
/// Where data begin in an answer, and in a request that writes.
const ANSWER_AT: usize = 17;
const WRITTEN_AT: usize = 16;
/// Begins a request that writes, and one that reads.
const WRITE: u8 = 0x50;
const READ: u8 = 0x51;

/// One of the two imagers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eye {
    /// Left.
    Left,
    /// Right.
    Right,
}

/// The control of a camera.
pub trait Unit {
    /// Its length, bytes.
    ///
    /// # Errors
    /// The camera has no such control, or is disconnected.
    fn length(&mut self) -> Result<usize, UnitError>;

    /// Writes it.
    ///
    /// # Errors
    /// The camera refused.
    fn set(&mut self, bytes: &[u8]) -> Result<(), UnitError>;

    /// Reads it.
    ///
    /// # Errors
    /// The camera refused.
    fn get(&mut self) -> Result<Vec<u8>, UnitError>;
}

impl Unit for v4l2::Camera {
    fn length(&mut self) -> Result<usize, UnitError> {
        let length = self.extension_length(UNIT, SELECTOR);
        length.map_err(|e| refused("asking for the length of what goes", &e))
    }

    fn set(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
        let set = self.extension_set(UNIT, SELECTOR, bytes);
        set.map_err(|e| refused("sending a request", &e))
    }

    fn get(&mut self) -> Result<Vec<u8>, UnitError> {
        let answer = self.extension_get(UNIT, SELECTOR);
        answer.map_err(|e| refused("reading an answer", &e))
    }
}

fn refused(doing: &'static str, error: &v4l2::CameraError) -> UnitError {
    UnitError::Refused {
        doing,
        reason: error.to_string(),
    }
}

/// Time for the exchange: the caller has the clock, and waits.
pub trait Time {
    /// Now, ns of CLOCK_MONOTONIC.
    fn now_ns(&mut self) -> i64;

    /// Returns after so long.
    fn wait(&mut self, time: Duration);
}

/// Why an exchange failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnitError {
    /// Not a camera of this make, or one of another firmware.
    #[error("{doing} through the camera's extension unit: {reason}")]
    Refused {
        /// The attempted operation.
        doing: &'static str,
        /// The error of the operating system.
        reason: String,
    },
    /// The control is too short for the request.
    #[error(
        "asking the camera's extension unit: its control has {found} bytes, expected 64 or 384"
    )]
    Length {
        /// Its length.
        found: usize,
    },
    /// The camera answers, but never with a serial number. It may be busy; try again.
    #[error(
        "reading the camera's serial number: found {found:02x?}, expected bytes that begin with \"OV\""
    )]
    NoSerial {
        /// The first bytes of the last answer.
        found: Vec<u8>,
    },
    /// The number is written in another way than is known.
    #[error("reading the camera's serial number: found {found:x}, expected decimal digits only")]
    Digits {
        /// The four bytes.
        found: u32,
    },
    /// A register did not keep what was written.
    #[error(
        "writing register {register:#x} of the camera: it shows {found:#04x}, expected {expected:#04x}"
    )]
    NotKept {
        /// Which.
        register: u32,
        /// What it shows.
        found: u8,
        /// What was written.
        expected: u8,
    },
}

/// A request for `length` bytes of flash at `address`.
pub fn read_flash(address: u32, length: u16) -> [u8; CONTROL_BYTES] {
    let mut request = [0; CONTROL_BYTES];
    request[..3].copy_from_slice(&[READ, 0xa1, 0x03]);
    request[5..9].copy_from_slice(&address.to_be_bytes());
    request[9..11].copy_from_slice(&(0x9000 | length).to_be_bytes());
    request[11..13].copy_from_slice(&length.to_be_bytes());
    request
}

/// A request that reads (`None`) or writes a register of an imager.
fn sensor_register(eye: Eye, register: u16, write: Option<u8>) -> [u8; CONTROL_BYTES] {
    let bus = match eye {
        Eye::Left => 0xa3,
        Eye::Right => 0xa5,
    };
    let mut request = register_request(write, [bus, 0x6c, 2], u32::from(register));
    request[9] = 0x90;
    request
}

/// A request that reads (`None`) or writes a register of the video chip itself.
fn system_register(register: u32, write: Option<u8>) -> [u8; CONTROL_BYTES] {
    register_request(write, [0xa2, 0, 4], register)
}

fn register_request(write: Option<u8>, place: [u8; 3], register: u32) -> [u8; CONTROL_BYTES] {
    let mut request = [0; CONTROL_BYTES];
    request[0] = if write.is_some() { WRITE } else { READ };
    request[1..4].copy_from_slice(&place);
    // One byte of data, one register.
    request[4] = 1;
    request[5..9].copy_from_slice(&register.to_be_bytes());
    request[9..13].copy_from_slice(&[0, 1, 0, 1]);
    request[WRITTEN_AT] = write.unwrap_or(0);
    request
}

/// The serial number out of an answer to [`read_flash`]: four bytes behind "OV" whose hexadecimal
/// digits are the number's decimal ones.
///
/// # Errors
/// [`UnitError::NoSerial`], [`UnitError::Digits`].
fn serial_of(answer: &[u8]) -> Result<u32, UnitError> {
    let data = answer.get(ANSWER_AT..ANSWER_AT + 6).unwrap_or_default();
    let &[b'O', b'V', a, b, c, d] = data else {
        return Err(UnitError::NoSerial {
            found: data.to_vec(),
        });
    };
    let found = u32::from_be_bytes([a, b, c, d]);
    format!("{found:x}")
        .parse()
        .map_err(|_| UnitError::Digits { found })
}

/// The camera's serial number. Requested again until `until_ns`, for a camera that has just started
/// answers with something else at first (the vendor's library asks up to 500 times).
///
/// # Errors
/// The last answer's; see [`UnitError`].
pub fn serial(unit: &mut impl Unit, time: &mut impl Time, until_ns: i64) -> Result<u32, UnitError> {
    loop {
        let read = exchange(unit, time, &read_flash(SERIAL_AT, SERIAL_BYTES))
            .and_then(|answer| serial_of(&answer));
        if read.is_ok() || time.now_ns() >= until_ns {
            return read;
        }
    }
}

/// Makes the imagers signal each frame to the microcontroller, which then marks its samples: bit
/// 0x80 of register 0x3002 of both. Needed at every start of the stream.
///
/// # Errors
/// See [`UnitError`]; without it there are no frame-sync flags, and times are those of arrivals.
pub fn activate_frame_sync(unit: &mut impl Unit, time: &mut impl Time) -> Result<(), UnitError> {
    const REGISTER: u16 = 0x3002;
    const SYNC_OUT: u8 = 0x80;
    for eye in [Eye::Left, Eye::Right] {
        let request = |write| sensor_register(eye, REGISTER, write);
        change(unit, time, u32::from(REGISTER), SYNC_OUT, true, request)?;
    }
    Ok(())
}

/// Whether exposure and gain of both imagers are automatic: bit 0x02 of registers 0x80181033 and
/// 0x80181833 of the video chip.
///
/// # Errors
/// See [`UnitError`].
pub fn set_auto_exposure(
    unit: &mut impl Unit,
    time: &mut impl Time,
    automatic: bool,
) -> Result<(), UnitError> {
    for register in [0x8018_1033, 0x8018_1833] {
        let request = |write| system_register(register, write);
        change(unit, time, register, 0x02, automatic, request)?;
    }
    Ok(())
}

/// Sets or clears bits of a register and looks whether it kept them.
fn change(
    unit: &mut impl Unit,
    time: &mut impl Time,
    register: u32,
    mask: u8,
    on: bool,
    request: impl Fn(Option<u8>) -> [u8; CONTROL_BYTES],
) -> Result<(), UnitError> {
    let before = exchange(unit, time, &request(None))?[ANSWER_AT];
    let expected = if on { before | mask } else { before & !mask };
    if expected == before {
        return Ok(());
    }
    send(unit, &request(Some(expected)))?;
    time.wait(ANSWER_AFTER);
    let found = exchange(unit, time, &request(None))?[ANSWER_AT];
    if found & mask != expected & mask {
        return Err(UnitError::NotKept {
            register,
            found,
            expected,
        });
    }
    Ok(())
}

fn send(unit: &mut impl Unit, request: &[u8; CONTROL_BYTES]) -> Result<usize, UnitError> {
    let found = unit.length()?;
    if !(ANSWER_AT + 6..=CONTROL_BYTES).contains(&found) {
        return Err(UnitError::Length { found });
    }
    unit.set(&request[..found])?;
    Ok(found)
}

fn exchange(
    unit: &mut impl Unit,
    time: &mut impl Time,
    request: &[u8; CONTROL_BYTES],
) -> Result<Vec<u8>, UnitError> {
    let asked = send(unit, request)?;
    time.wait(ANSWER_AFTER);
    let answer = unit.get()?;
    match answer.len() {
        found if found < asked => Err(UnitError::Length { found }),
        _ => Ok(answer),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    /// A camera's video chip: the last request, its registers, and when it is ready.
    struct Chip {
        length: usize,
        asked: Vec<u8>,
        registers: BTreeMap<(u8, u32), u8>,
        serial: [u8; 6],
        ready_ns: i64,
        now_ns: i64,
        keeps: bool,
    }

    struct Clock<'a>(&'a std::cell::RefCell<Chip>);
    struct Wire<'a>(&'a std::cell::RefCell<Chip>);

    impl Time for Clock<'_> {
        fn now_ns(&mut self) -> i64 {
            self.0.borrow().now_ns
        }

        fn wait(&mut self, time: Duration) {
            self.0.borrow_mut().now_ns += time.as_nanos() as i64;
        }
    }

    impl Unit for Wire<'_> {
        fn length(&mut self) -> Result<usize, UnitError> {
            Ok(self.0.borrow().length)
        }

        fn set(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
            let mut chip = self.0.borrow_mut();
            assert_eq!(bytes.len(), chip.length);
            let register = u32::from_be_bytes([bytes[5], bytes[6], bytes[7], bytes[8]]);
            if bytes[0] == WRITE && chip.keeps {
                chip.registers.insert((bytes[1], register), bytes[16]);
            }
            chip.asked = bytes.to_vec();
            Ok(())
        }

        fn get(&mut self) -> Result<Vec<u8>, UnitError> {
            let chip = self.0.borrow();
            let mut bytes = vec![0; chip.length];
            let register =
                u32::from_be_bytes([chip.asked[5], chip.asked[6], chip.asked[7], chip.asked[8]]);
            if chip.asked[1] != 0xa1 {
                bytes[17] = chip
                    .registers
                    .get(&(chip.asked[1], register))
                    .copied()
                    .unwrap_or(0x11);
            } else if register == 0x18000 && chip.now_ns >= chip.ready_ns {
                bytes[17..23].copy_from_slice(&chip.serial);
            }
            Ok(bytes)
        }
    }

    fn chip() -> std::cell::RefCell<Chip> {
        std::cell::RefCell::new(Chip {
            length: CONTROL_BYTES,
            asked: Vec::new(),
            registers: BTreeMap::new(),
            serial: [b'O', b'V', 0x00, 0x01, 0x23, 0x45],
            ready_ns: 0,
            now_ns: 0,
            keeps: true,
        })
    }

    #[test]
    fn requests_are_the_published_bytes() {
        let flash = read_flash(0x18000, 64);
        assert_eq!(
            flash[..17],
            [
                0x51, 0xa1, 3, 0, 0, 0, 1, 0x80, 0, 0x90, 0x40, 0, 0x40, 0, 0, 0, 0
            ]
        );
        let write = sensor_register(Eye::Right, 0x3002, Some(0x91));
        assert_eq!(
            write[..17],
            [
                0x50, 0xa5, 0x6c, 2, 1, 0, 0, 0x30, 0x02, 0x90, 1, 0, 1, 0, 0, 0, 0x91
            ]
        );
        let read = system_register(0x8018_1033, None);
        assert_eq!(
            read[..17],
            [
                0x51, 0xa2, 0, 4, 1, 0x80, 0x18, 0x10, 0x33, 0, 1, 0, 1, 0, 0, 0, 0
            ]
        );
    }

    #[test]
    fn the_serial_number_is_read_on_usb_3_and_2() {
        for length in [384, 64] {
            let chip = chip();
            chip.borrow_mut().length = length;
            let serial = serial(&mut Wire(&chip), &mut Clock(&chip), 0);
            assert_eq!(serial, Ok(12345));
        }
    }

    #[test]
    fn a_camera_that_is_not_ready_is_asked_again_until_the_time_is_up() {
        let chip = chip();
        chip.borrow_mut().ready_ns = 100_000_000;
        let early = serial(&mut Wire(&chip), &mut Clock(&chip), 50_000_000);
        assert_eq!(early, Err(UnitError::NoSerial { found: vec![0; 6] }));
        let ready = serial(&mut Wire(&chip), &mut Clock(&chip), 200_000_000);
        assert_eq!(ready, Ok(12345));
        chip.borrow_mut().length = 8;
        let short = serial(&mut Wire(&chip), &mut Clock(&chip), 0);
        assert_eq!(short, Err(UnitError::Length { found: 8 }));
    }

    #[test]
    fn digits_that_are_no_decimals_are_no_serial_number() {
        let mut answer = [0; 64];
        answer[17..23].copy_from_slice(&[b'O', b'V', 0, 0, 0x1a, 0x00]);
        let error = serial_of(&answer).expect_err("a digit above nine");
        assert_eq!(
            error.to_string(),
            "reading the camera's serial number: found 1a00, expected decimal digits only"
        );
        assert_eq!(serial_of(&[]), Err(UnitError::NoSerial { found: vec![] }));
    }

    #[test]
    fn frame_sync_sets_one_bit_on_both_imagers_and_looks_whether_it_stays() {
        let chip = chip();
        activate_frame_sync(&mut Wire(&chip), &mut Clock(&chip)).expect("kept");
        let registers = chip.borrow().registers.clone();
        assert_eq!(
            registers,
            [((0xa3, 0x3002), 0x91), ((0xa5, 0x3002), 0x91)].into()
        );
        // Once more changes nothing.
        activate_frame_sync(&mut Wire(&chip), &mut Clock(&chip)).expect("kept");
        assert_eq!(chip.borrow().registers, registers);

        set_auto_exposure(&mut Wire(&chip), &mut Clock(&chip), true).expect("kept");
        assert_eq!(chip.borrow().registers[&(0xa2, 0x8018_1833)], 0x13);
        set_auto_exposure(&mut Wire(&chip), &mut Clock(&chip), false).expect("kept");
        assert_eq!(chip.borrow().registers[&(0xa2, 0x8018_1033)], 0x11);

        chip.borrow_mut().keeps = false;
        let lost = set_auto_exposure(&mut Wire(&chip), &mut Clock(&chip), true);
        let register = 0x8018_1033;
        let (found, expected) = (0x11, 0x13);
        assert_eq!(
            lost,
            Err(UnitError::NotKept {
                register,
                found,
                expected
            })
        );
    }
}
