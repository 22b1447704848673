//! ZED cameras over USB: the microcontroller's reports, frame sync, serial numbers.
