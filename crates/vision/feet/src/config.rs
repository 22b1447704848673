//! Configuration of the tracking of shoe tags, and of contacts and swings.

use estimator_config::config;

config! {
    /// Configuration of [`TagTracker`](crate::tag_tracker::TagTracker).
    pub struct Config {
        /// Motion of feet between frames.
        pub prediction: PredictionConfig = PredictionConfig::default(),
        /// Search for tags that are not where they are predicted.
        pub search: SearchConfig = SearchConfig::default(),
        /// Images that repeat the one before.
        pub repeated: RepeatedConfig = RepeatedConfig::default(),
        /// Fit of a tag.
        pub fit: fiducials::Config = fiducials::Config::default(),
        /// Maximum speed of a foot, m/s. Faster ones are mismatches.
        pub max_speed: f64 = 8.0,
        /// Maximum distance of a foot from the rig, m.
        pub max_distance_m: f64 = 2.2,
        /// Frames from one to the next in which each eye alone is compared with the other one.
        pub eye_check_frames: u64 = 4,
    }

    /// Motion of feet between frames.
    pub struct PredictionConfig {
        /// Time for which a foot is taken to go on with its last velocity, s.
        pub max_extrapolation_s: f64 = 0.1,
        /// Speed below which a foot is taken to stand, m/s.
        pub standing_speed: f64 = 0.25,
        /// Maximum time between detections of which a velocity is formed, s.
        pub max_velocity_interval_s: f64 = 0.15,
    }

    /// Search for tags without a prediction of their pose.
    pub struct SearchConfig {
        /// Detection of tags of any identity.
        pub detection: fiducials::SearchConfig = fiducials::SearchConfig::default(),
        /// Minimum distance of a shoe from a camera, m: larger dark regions are no tags.
        pub min_distance_m: f64 = 0.4,
        /// Time without a detection of a foot after which whole images are searched, s: after a
        /// swing it is somewhere else.
        pub lost_s: f64 = 0.15,
        /// Distance around a predicted tag in which it is searched if it is not there, m.
        pub near_m: f64 = 0.3,
        /// Location of tags that are blurred too much to be detected.
        pub location: fiducials::LocateConfig = fiducials::LocateConfig::default(),
        /// Motion of a tag at rest during the exposure from which on it is located so, cells.
        pub min_blur_cells: f64 = 0.7,
        /// Minimum share of the cells of such a tag that agree with its code: blurred bits hardly
        /// contradict the tag of the other foot.
        pub min_agreeing_share: f64 = 0.85,
        /// Time after the last detection from which on a foot may have landed elsewhere, s.
        pub landing_s: f64 = 0.25,
        /// Distance around the rig in which feet may land, m.
        pub landing_m: f64 = 0.6,
        /// Directions of a foot that are tried, relative to its last one, rad.
        pub turns_rad: [f64; 3] = [0.0, -0.3, 0.3],
        /// Difference of heights of a foot that are tried apart, m.
        pub height_m: f64 = 0.08,
    }

    /// Images that repeat the one before.
    pub struct RepeatedConfig {
        /// Share of the rows from which on an image is one: noise differs in each of them.
        pub max_share: f64 = 0.05,
        /// Speed of the rig, m/s, and angular rate, rad/s, from which on its images differ.
        pub min_motion: [f64; 2] = [0.05, 0.05],
    }

    /// Clocks of cameras, from feet at rest.
    pub struct ClockConfig {
        /// Least number of stances that say something.
        pub min_stances: f64 = 6.0,
        /// Least number of frames of a stance that says something.
        pub min_frames: usize = 4,
        /// Standard deviation of a place besides that of its pose: soles bend, m.
        pub place_sigma_m: f64 = 0.002,
        /// Largest standard deviation by that alone with which an error is known, s.
        pub max_sigma_s: f64 = 0.003,
        /// Usual error by soles that roll, and its standard deviation from walk to walk, s: of the
        /// fifteen walks that this was developed with.
        pub roll_s: [f64; 2] = [0.0015, 0.001],
        /// Standard deviations from which on an error is one, and its least size, s.
        pub min_sigmas: f64 = 3.0,
        /// See `min_sigmas`.
        pub min_error_s: f64 = 0.002,
        /// Least ratio of the motion of feet at rest to that of the rig by which poses drift.
        pub min_drift: f64 = 0.006,
        /// Standard deviations from which on it is one.
        pub min_drift_sigmas: f64 = 3.0,
        /// Usual ratio by soles that roll on level ground, and its standard deviation from walk to
        /// walk, of twelve of these.
        pub roll_drift: [f64; 2] = [0.002, 0.001],
        /// Share of the frames of feet at rest below which errors are tried with which they might
        /// rest more often.
        pub usual_rest_share: f64 = 0.45,
        /// These errors, s.
        pub guesses_s: [f64; 4] = [-0.045, -0.025, 0.025, 0.045],
        /// Number of frames at rest relative to that without an error from which on one counts.
        pub better_rest_ratio: f64 = 1.3,
        /// Largest error, s: frames of another step.
        pub max_error_s: f64 = 0.06,
    }

    /// Jumps of the poses of the rig, from feet at rest.
    pub struct JumpConfig {
        /// Longest time between two frames between which a jump is, s.
        pub max_interval_s: f64 = 0.2,
        /// Least time for which a foot is at rest before and after it, s.
        pub min_rest_s: f64 = 0.06,
        /// Least displacement, m.
        pub min_shift_m: f64 = 0.025,
        /// Largest rotation, rad: feet that step turn or tilt.
        pub max_turn_rad: f64 = 0.1,
        /// Least size of a jump of the poses themselves, m, and relative to the median of what
        /// poses of a person who walks show.
        pub min_position_m: f64 = 0.035,
        /// See `min_position_m`.
        pub usual_factor: f64 = 6.0,
        /// Time before and after a jump of the poses themselves, s, in which it is larger than any
        /// other by a factor: people who run jolt the rig at every strike.
        pub alone_s: f64 = 1.5,
        /// See `alone_s`.
        pub alone_factor: f64 = 2.5,
        /// Frames before and after it that count.
        pub frames: usize = 4,
    }

    /// Feet that slide before they rest.
    pub struct SlideConfig {
        /// Time before the first frame at rest in which a foot slides, s.
        pub max_time_s: f64 = 0.35,
        /// Tilt against its pose at rest up to which a foot is flat, rad: it strikes with its toe
        /// up by more.
        pub max_tilt_rad: f64 = 0.1,
        /// Height above that up to which it is on the ground, m.
        pub max_height_m: f64 = 0.012,
        /// Displacements along the ground that are those of a slide, m.
        pub shift_m: [f64; 2] = [0.018, 0.2],
        /// Least number of contacts with one, of walks with more contacts than that.
        pub min_contacts: usize = 2,
    }

    /// Feet from their tags.
    pub struct FootConfig {
        /// Edges of a sole of which no outline is known, from its middle, m.
        pub heel_m: f64 = 0.14,
        /// See `heel_m`.
        pub toe_m: f64 = 0.14,
        /// Least and largest length of a sole, m: of adults, beyond which an outline is wrong.
        pub sole_length_m: [f64; 2] = [0.2, 0.36],
        /// Standard deviation of the tilt of a moving sole, for the choice between the two poses of
        /// a tag that images hardly distinguish, rad.
        pub level_sigma_rad: f64 = 0.3,
        /// The same of a sole whose tag does not move: feet rest on ground that they can stand on.
        pub rest_level_sigma_rad: f64 = 0.15,
        /// What a speed of the tag adds to that, rad per m/s.
        pub level_sigma_per_speed: f64 = 0.3,
        /// Pitch of a foot that approaches its strike, toe up, and its standard deviation, rad.
        pub approach_pitch: [f64; 2] = [0.2, 0.15],
        /// Time from a frame to a foot's rest in which it approaches its strike, s.
        pub landing_s: f64 = 0.3,
        /// Largest slope of a path that widens these tilts, as a ratio: treads are level.
        pub max_slope: f64 = 0.3,
        /// Time between frames of one approach, and of a speed, s.
        pub max_approach_s: f64 = 0.2,
        /// Speed of the tag of a foot at rest, m/s.
        pub rest_speed: f64 = 0.2,
        /// Excess of the cost of a second pose that is as improbable as one standard deviation of
        /// that tilt: neighboring pixels share their errors.
        pub excess_per_square: f64 = 9.0,
        /// Errors of poses of tags relative to their stated sigmas: errors of lenses, blur and tone
        /// are not in these.
        pub sigma_factor: f64 = 1.8,
        /// The same of tags that are visible by less than `whole_share`: a fit takes what covers a
        /// part of a tag for a tilt.
        pub covered_sigma_factor: f64 = 12.0,
        /// See `covered_sigma_factor`.
        pub whole_share: f64 = 0.95,
        /// Angular rate of a foot, for the same choice, rad/s.
        pub turn_rate: f64 = 2.5,
        /// The same of a foot whose tag does not move, rad/s.
        pub rest_turn_rate: f64 = 0.5,
        /// What a speed of the tag adds to that, rad/m: a foot that rolls moves its tag.
        pub turn_rate_per_speed: f64 = 10.0,
        /// Maximum cost of a rotation from frame to frame: feet may turn fast where none shows
        /// them.
        pub max_change_cost: f64 = 16.0,
        /// Cost of the rotation between two frames up to which one between them, which costs the
        /// maximum from both, is left out.
        pub agreeing_change_cost: f64 = 4.0,
    }

    /// Placement of the tags on shoes, from the ground below the feet at rest.
    pub struct PlacementConfig {
        /// Least number of contacts that say something, on either side of a change.
        pub min_contacts: f64 = 8.0,
        /// Least number of contacts by which a placement contradicts its tolerance.
        pub min_gross_contacts: f64 = 4.0,
        /// Least standard deviation of the height of a sole at rest, m: of the ground below it and
        /// of a frame's pose.
        pub height_floor_m: f64 = 0.0015,
        /// Likewise of its tilt, rad.
        pub tilt_floor_rad: f64 = 0.009,
        /// Likewise of its direction relative to the course, rad.
        pub heading_floor_rad: f64 = 0.026,
        /// Standard deviation of the error of the height that all contacts share, m: of stereo
        /// depth and of the fit of a tag.
        pub shared_height_m: f64 = 0.002,
        /// Likewise of the tilt, rad.
        pub shared_tilt_rad: f64 = 0.01,
        /// Sigmas beyond which a change is one: there are a hundred times and four quantities.
        pub slip_sigmas: f64 = 6.0,
        /// Least change of the height, m.
        pub min_height_slip_m: f64 = 0.004,
        /// Least change of the tilt, rad.
        pub min_tilt_slip_rad: f64 = 0.035,
        /// Least change of the direction, rad.
        pub min_heading_slip_rad: f64 = 0.06,
        /// Least distance of two steps of a foot between which the other one shows its side, m.
        pub min_stride_m: f64 = 0.4,
        /// Least median distance to the wrong side by which tags are exchanged, m: feet that cross
        /// a little are none.
        pub min_offset_m: f64 = 0.02,
        /// Standard deviation of the height of a tag of which the rig file states none, m.
        pub usual_height_sigma_m: f64 = 0.005,
        /// Likewise of its tilt, rad.
        pub usual_tilt_sigma_rad: f64 = 0.05,
        /// Likewise of its place along and across the sole, m.
        pub usual_along_sigma_m: f64 = 0.003,
        /// Likewise of its heading, rad.
        pub usual_heading_sigma_rad: f64 = 0.03,
    }

    /// Configuration of contacts and swings.
    pub struct GaitConfig {
        /// Feet at rest.
        pub stance: StanceConfig = StanceConfig::default(),
        /// Times of contacts.
        pub events: EventConfig = EventConfig::default(),
        /// Feet between contacts.
        pub swing: SwingConfig = SwingConfig::default(),
    }

    /// Feet between contacts. Axes are those of the step for the position (forward, left, up) and
    /// those of the foot for the rotation: m, rad.
    pub struct SwingConfig {
        /// Standard deviation of the usual swing of a wearer from that of people, in mid-step.
        pub shared_sigma: [f64; 6] = [0.1, 0.02, 0.06, 0.06, 0.3, 0.08],
        /// Of one swing from the usual one of its wearer.
        pub own_sigma: [f64; 6] = [0.03, 0.015, 0.02, 0.04, 0.1, 0.04],
        /// Time over which the latter is correlated, s.
        pub correlation_s: f64 = 0.15,
        /// Standard deviations of hidden parts relative to those that follow from the above: errors
        /// on the walks that this was developed with were that much larger.
        pub hidden_factor: f64 = 1.2,
        /// The same of steps that rise or fall.
        pub climb_factor: f64 = 1.5,
        /// Standard deviations of the lift and of the strike from which on a foot that no frame
        /// shows is lost between its contacts, s: frames are missing.
        pub max_lift_sigma_s: f64 = 0.12,
        /// See `max_lift_sigma_s`.
        pub max_strike_sigma_s: f64 = 0.2,
        /// Maximum time from a contact to the next one of the same foot that is one step, s.
        pub max_swing_s: f64 = 1.5,
        /// Time to the next frame of the foot up to which its pose is observed, s.
        pub observed_s: f64 = 0.05,
        /// Time after the last frame for which a foot at rest is taken to stay, where later frames
        /// are unknown, s: a foot that the example's mount no longer shows may lift soon.
        pub causal_held_s: f64 = 0.12,
    }

    /// Feet at rest.
    pub struct StanceConfig {
        /// Speed below which a foot may be at rest between two frames, besides three sigmas of
        /// their poses, m/s.
        pub max_speed: f64 = 0.15,
        /// Angular rate, likewise, rad/s. Feet roll over heel and toe at 2 to 5 rad/s.
        pub max_rate: f64 = 0.6,
        /// Speed of its tag below which it is at rest all the same where the tilts of both poses
        /// contradict each other, m/s: fits of small tags end in a wrong tilt at times.
        pub max_place_speed: f64 = 0.06,
        /// Maximum time between frames of a foot at rest, s.
        pub max_gap_s: f64 = 0.35,
        /// Maximum time without a frame between two poses that are one stance if they agree, s.
        pub max_hidden_s: f64 = 0.5,
        /// Time in which no foot lifts, swings and comes down, s.
        pub min_swing_s: f64 = 0.2,
        /// Minimum number of frames of a foot at rest.
        pub min_frames: usize = 2,
        /// Distance and rotation from the mean pose of a foot at rest from which on frames do not
        /// belong to it, besides three sigmas, m and rad.
        pub max_deviation_m: f64 = 0.01,
        /// See `max_deviation_m`.
        pub max_deviation_rad: f64 = 0.05,
        /// Displacement and rotation within a stance from which on it is two: a slide, or weight
        /// that is shifted, m and rad.
        pub max_drift_m: f64 = 0.02,
        /// See `max_drift_m`.
        pub max_drift_rad: f64 = 0.09,
        /// Displacement and rotation between two parts of a contact up to which the foot rests in
        /// both, m and rad.
        pub max_settling_m: f64 = 0.04,
        /// See `max_settling_m`.
        pub max_settling_rad: f64 = 0.2,
        /// Standard deviation of a foot at rest about its pose in a frame, m and rad: shoes give
        /// way, and a fit knows the place of a tag across its rays to a hundredth of a millimeter.
        pub frame_sigma: [f64; 2] = [0.001, 0.004],
        /// Standard deviation of errors that all frames of a stance share: in the plane of the
        /// sole and along its normal, m; tilt and heading, rad.
        pub shared_sigma: [f64; 4] = [0.002, 0.003, 0.015, 0.005],
    }

    /// Times of contacts. Numbers of motions are means, with standard deviations between people and
    /// between the steps of one of them.
    pub struct EventConfig {
        /// Speed of the heel at its strike, m/s, and its deceleration before, m/s².
        pub strike_speed: [f64; 3] = [0.4, 0.2, 0.2],
        /// See `strike_speed`.
        pub strike_deceleration: [f64; 3] = [18.0, 7.0, 6.0],
        /// Pitch of the foot at its strike, toe up, rad.
        pub strike_pitch: [f64; 3] = [0.28, 0.1, 0.08],
        /// Time from heel strike to foot flat, s.
        pub loading_s: [f64; 3] = [0.075, 0.018, 0.012],
        /// Time before the strike in which the approach of a foot is used, s.
        pub max_approach_s: f64 = 0.2,
        /// Maximum speed of an approach, m/s.
        pub max_speed: f64 = 6.0,
        /// Height of the heel, against that at rest, up to which it may slide on the ground, m.
        pub slide_height_m: f64 = 0.006,
        /// Displacements of the heel along the ground that may be those of a slide, m.
        pub slide_m: [f64; 2] = [0.015, 0.2],
        /// Share of a stride by which a foot bears longer than that of people at the same speed.
        pub bearing_share: [f64; 3] = [0.0, 0.027, 0.01],
        /// Share of a stride after which the heel lifts.
        pub heel_lift_share: [f64; 3] = [0.35, 0.05, 0.03],
        /// Acceleration of the pitch as the heel lifts, and its standard deviation, rad/s².
        pub heel_lift_acceleration: [f64; 2] = [30.0, 15.0],
        /// Speed with which the toe leaves the ground, m/s, and its acceleration then, m/s², with
        /// their standard deviations.
        pub toe_speed: [f64; 2] = [0.5, 0.5],
        /// See `toe_speed`.
        pub toe_acceleration: [f64; 2] = [25.0, 12.0],
    }
}

impl ClockConfig {
    /// Whether a clock is late by this time with this standard deviation, s.
    pub fn is_error(&self, late_s: f64, sigma_s: f64) -> bool {
        let least_s = (self.min_sigmas * sigma_s).max(self.min_error_s);
        (least_s..=self.max_error_s).contains(&late_s.abs())
    }
}
