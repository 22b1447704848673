//! Button, light and beeper: how a person without a screen starts, stops and knows.
