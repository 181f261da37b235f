//! The promises of the documents in the order of their sentences, and sentences that read like promises but are none.

use super::Document::{Mission, Protocol};
use super::Judge::{Conformance, Falsified, Simulation, Test};
use super::{Document, Promise};

/// Each sentence that promises a behaviour, with its judges.
pub const PROMISES: &[Promise] = &[
    (
        Mission,
        "On this page, \"round trip\" is the longest `delay_high_ms` among the robots of the act \
         (clocks.md), at most 500 ms.",
        &[Simulation('h', "08-one-hiccup-inflates-the-show")],
    ),
    (
        Mission,
        "A single slow moment does not set this value, and old measurements are forgotten.",
        &[Simulation('h', "08-one-hiccup-inflates-the-show")],
    ),
    (
        Mission,
        "The mission connects to all robots at once.",
        &[Test(
            "scheduler/mission/src/drive/tests.rs::links_to_all_robots_are_begun_before_anything_happens_on_one_of_them",
        )],
    ),
    (
        Mission,
        "It asks each robot for its initialization block, which has to contain the robot's id (see \
         below).",
        &[Test("tests/processes/security/identity.rs::with_two_addresses_swapped_neither_robot_moves")],
    ),
    (
        Mission,
        "While the fleet's possible spread of starts is larger than `start_tolerance`, or a round trip is \
         longer than 3 s, the mission samples the clocks for up to 4 s more: a robot may have been slow \
         only as long as thousands of others were connected to.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::a_robot_that_stays_slow_is_measured_further_for_four_seconds_and_then_refused",
        )],
    ),
    (
        Mission,
        "It retries a link that breaks until `--patience` ends (5 s), and a robot that refuses \
         connections for 500 ms.",
        &[Simulation('h', "12b-one-refused-connection-ends-the-greeting")],
    ),
    (
        Mission,
        "It waits until all robots have answered or failed before it gives up, so one report names \
         everything to fix.",
        &[Test("tests/processes/security/identity.rs::with_two_addresses_swapped_neither_robot_moves")],
    ),
    (
        Mission,
        "It also reads all other sensors, lists every reading, and measures how late this host wakes its \
         own robots.",
        &[
            Test(
                "tests/processes/missions/preflight.rs::preflight_shows_where_devices_stand_and_what_every_sensor_reads",
            ),
            Test(
                "tests/processes/clocks/realtime.rs::preflight_tells_how_late_this_host_wakes_up_and_what_it_was_granted",
            ),
        ],
    ),
    (
        Mission,
        "clock | the robot can start within `start_tolerance` of the others",
        &[Simulation('f', "15-the-skew-budget-never-refuses")],
    ),
    (
        Mission,
        "A device with a first keyframe later than 0 s jumps only if its largest speed is too low for the \
         distance.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::a_device_that_jumps_or_has_time_to_get_there_may_stand_anywhere",
        )],
    ),
    (
        Mission,
        "Lamps and other devices that hold their value and have no limit never jump.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::a_device_that_jumps_or_has_time_to_get_there_may_stand_anywhere",
        )],
    ),
    (Mission, "A start that jumps is refused.", &[Simulation('m', "19-a-start-jumps")]),
    (
        Mission,
        "`downbeat run show.yaml --approach 5s` first asks all robots for their positions, and then plays \
         an additional act that moves these devices to their first positions in 5 s, including those that \
         first move in a later act.",
        &[
            Test(
                "tests/processes/missions/start_poses.rs::an_approach_moves_devices_to_their_first_positions_at_no_more_than_their_speed",
            ),
            Test(
                "scripts/src/approach.rs::a_device_that_first_moves_in_a_later_act_is_moved_to_the_position_that_this_act_expects",
            ),
        ],
    ),
    (
        Mission,
        "This act is compiled like any other: it keeps the limits of the block and the fleet file, and \
         avoids collisions as far as bodies are known.",
        &[
            Test(
                "scripts/src/approach.rs::an_approach_faster_than_a_device_is_refused_and_the_time_that_it_needs_is_named",
            ),
            Test(
                "scripts/src/approach.rs::an_approach_that_would_collide_with_a_robot_that_stays_is_refused",
            ),
        ],
    ),
    (
        Mission,
        "Like the first act, it is committed for all robots or none; if `on_failure` is `without`, it is \
         committed without the robots that have failed.",
        &[Test(
            "scheduler/rehearsal/src/dry_run/tests/approach.rs::an_approach_is_committed_for_all_robots_or_none_or_without_those_that_failed_as_the_show_says",
        )],
    ),
    (
        Mission,
        "The option works with `--act`, `--from`, `--only`, `--at` and `resume`, but not with `--seize` \
         or `--require-certificate`.",
        &[
            Test(
                "scheduler/src/cli/run.rs::an_approach_goes_with_options_that_choose_acts_and_with_none_that_takes_robots_or_binds_the_plan",
            ),
            Test(
                "tests/processes/missions/start_poses.rs::a_mission_that_was_killed_while_it_approached_goes_on_after_resume",
            ),
            Test(
                "tests/processes/missions/start_poses.rs::an_approach_is_played_at_once_and_the_show_starts_at_its_time",
            ),
        ],
    ),
    (
        Mission,
        "While the command asks the robots, a signal such as Ctrl-C ends it at once, and nothing has \
         moved.",
        &[Test(
            "tests/processes/missions/start_poses.rs::a_signal_ends_the_command_while_it_asks_the_robots_and_nothing_has_moved",
        )],
    ),
    (
        Mission,
        "If a robot joins later, the mission asks it for its positions just before the first act that the \
         robot plays, and leaves the robot out if it would jump.",
        &[Simulation('m', "20-a-robot-that-joins-jumps")],
    ),
    (
        Mission,
        "If another act is the first one that moves a device, for example after a wait that timed out or after \
         a failure, the mission asks for the position of that device just before this act.",
        &[Simulation('m', "22-a-device-that-has-not-moved-jumps")],
    ),
    (
        Mission,
        "A robot that would jump then, or does not answer within three round trips and 200 ms, has failed.",
        &[
            Test(
                "scheduler/mission/src/tests/greeting.rs::a_device_that_first_moves_in_an_act_that_does_not_follow_by_next_may_not_jump_either",
            ),
            Test(
                "scheduler/mission/src/tests/greeting.rs::a_robot_that_does_not_state_where_its_untouched_device_is_does_not_move_it",
            ),
        ],
    ),
    (
        Mission,
        "The mission promises an act only once each such robot has answered a question on its new link.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::an_act_is_promised_only_once_a_robot_has_answered_on_its_new_link",
        )],
    ),
    (
        Mission,
        "A robot that identifies itself but does not answer within three round trips and 200 ms has failed, \
         unless it still plays another act.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::an_act_is_promised_only_once_a_robot_has_answered_on_its_new_link",
        )],
    ),
    (
        Mission,
        "The mission asks for it first on every new link, also in the middle of a mission, after `resume` \
         and during a stop, and sends nothing else until the robot has answered.",
        &[
            Test(
                "scheduler/mission/src/tests/greeting.rs::robots_are_asked_who_they_are_and_eight_times_for_their_clock_before_anything_is_sent",
            ),
            Test(
                "tests/processes/security/identity.rs::a_robot_that_takes_over_an_address_in_mid_mission_is_sent_nothing_and_its_predecessor_has_failed",
            ),
            Test("tests/processes/security/identity.rs::a_mission_is_not_resumed_on_another_robot"),
        ],
    ),
    (
        Mission,
        "Stops wait for the answer for 250 ms at most.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::a_robot_that_says_nothing_is_sent_its_stop_after_a_moment_and_one_that_says_it_is_another_is_not",
        )],
    ),
    (
        Mission,
        "A robot that says nothing is sent the stop nevertheless, but only the expected robot can confirm \
         it.",
        &[Test(
            "tests/processes/security/identity.rs::a_stop_after_a_crash_reaches_a_robot_that_does_not_say_which_one_it_is_and_is_not_confirmed_by_it",
        )],
    ),
    (
        Mission,
        "A go counts for the act that waits for it now; `go ACT` counts only for the act that it names.",
        &[Test(
            "scheduler/mission/src/tests.rs::a_go_counts_for_the_act_that_waits_for_it_and_otherwise_says_why_not",
        )],
    ),
    (
        Mission,
        "An act is sent up to 2 s before it has to be, while the previous act plays, as soon as every \
         device has room for its first script.",
        &[Test(
            "tests/processes/missions/missions.rs::a_device_with_room_for_two_scripts_plays_two_acts_without_a_gap",
        )],
    ),
    (
        Mission,
        "No robot makes the others wait without bound: the part of the lead that follows from links and \
         clocks is at most 1.5 s of *prepare*, and the lease before the start at most 10 s.",
        &[
            Test("scheduler/mission/src/lead.rs::a_very_slow_link_does_not_make_the_show_wait_without_bound"),
            Test(
                "scheduler/mission/src/tests/hostile.rs::no_robot_makes_the_others_wait_for_a_lease_without_bound",
            ),
        ],
    ),
    (
        Mission,
        "If the budget is larger than `start_tolerance`, the robots that cause this fail.",
        &[Simulation('f', "15-the-skew-budget-never-refuses")],
    ),
    (
        Mission,
        "If the disk takes longer than *prepare*, nothing is sent.",
        &[Test(
            "scheduler/mission/src/act/tests/preparing.rs::a_promise_that_is_not_on_the_disk_in_time_is_not_sent",
        )],
    ),
    (
        Mission,
        "If the disk has not even taken the first record within `--patience`, or takes no more records, \
         the mission ends before anything is sent (`journal_lost`).",
        &[
            Test(
                "scheduler/mission/src/tests/course.rs::the_disk_has_to_store_the_begin_of_the_journal_within_the_operators_patience",
            ),
            Test(
                "scheduler/simulation/src/tests.rs::a_disk_that_stands_still_ends_the_mission_before_anything_moves",
            ),
        ],
    ),
    (
        Mission,
        "The act is decided as soon as every robot has accepted every script for which its devices have \
         room, each bound to its content hash.",
        &[Simulation('g', "13-decides-without-all-acceptances")],
    ),
    (
        Mission,
        "An act with a fixed start, by `--at` or by a time for which it waits, is prepared again only \
         with `run --start-within 10s`, which permits a start up to 10 s after the fixed one.",
        &[
            Test(
                "scheduler/mission/src/tests/again.rs::an_act_with_a_fixed_start_is_prepared_again_within_the_permitted_time",
            ),
            Test(
                "scheduler/mission/src/tests/again.rs::an_act_with_an_instant_of_its_own_is_not_prepared_again",
            ),
        ],
    ),
    (
        Mission,
        "A start by `--at` that is too soon is later within the same time.",
        &[Test(
            "scheduler/mission/src/tests/again.rs::a_start_that_is_too_soon_is_later_within_the_permitted_time",
        )],
    ),
    (
        Mission,
        "`run` and `preflight` then print the nearest times that exist, and send nothing.",
        &[Test(
            "tests/processes/missions/local_times.rs::a_start_that_clocks_skip_is_refused_with_the_nearest_times",
        )],
    ),
    (
        Mission,
        "If an act reaches such a day only in the course of the mission, it starts at the instant at \
         which the clocks skip its time, and the mission reports this.",
        &[Test(
            "scheduler/mission/src/act/tests/waiting.rs::an_act_whose_time_clocks_skip_starts_as_they_skip_it_and_says_so",
        )],
    ),
    (
        Mission,
        "After the decision, the mission asks every robot in rounds whether it still holds its scripts.",
        &[
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::the_commitment_needs_every_answer_to_one_of_the_last_two_rounds",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::every_question_before_the_critical_instant_carries_a_lease_that_ends_before_the_start",
            ),
        ],
    ),
    (
        Mission,
        "Only the commitment moves this limit, to one second or more after the start of each script.",
        &[
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_limit_ends_before_the_start_by_the_same_clock_however_far_that_was_set",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_script_that_is_sent_once_its_act_is_committed_may_start",
            ),
        ],
    ),
    (
        Mission,
        "At the critical instant, one last lease before the brink, the scheduler falls silent: what it \
         sent before this instant starts no robot.",
        &[
            Test(
                "scheduler/mission/src/act/timing.rs::whatever_is_sent_before_the_critical_instant_carries_a_lease_that_ends_before_the_start",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::every_question_before_the_critical_instant_carries_a_lease_that_ends_before_the_start",
            ),
        ],
    ),
    (
        Mission,
        "If it becomes apparent that a clock has been set meanwhile, within the tolerance, the mission \
         recomputes *early* and *late* and prints the limits again, as long as two rounds are left for \
         that.",
        &[
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_clock_that_was_set_within_the_tolerance_moves_the_end_of_all_leases",
            ),
            Test(
                "scheduler/mission/src/act/timing.rs::a_clock_is_allowed_for_while_two_rounds_are_left_and_the_lease_can_carry_it",
            ),
        ],
    ),
    (
        Mission,
        "Its conditions are that every robot has answered one of the last two rounds that it holds its \
         scripts, that every clock is still right, and that the commitment is on disk.",
        &[
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::the_commitment_needs_every_answer_to_one_of_the_last_two_rounds",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_clock_that_was_set_after_the_decision_is_a_failure_before_the_commitment",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::the_commitment_is_on_the_disk_before_any_robot_is_told",
            ),
        ],
    ),
    (
        Mission,
        "Stops never wait.",
        &[Test(
            "scheduler/mission/src/tests/stops.rs::a_stop_is_sent_at_once_while_everything_else_waits_for_the_commitment",
        )],
    ),
    (
        Mission,
        "If a robot is missing 5 ms before the last instant at which the commitment still reaches every \
         robot (the brink, less 8 ms, two round trips or the lateness), it has failed.",
        &[
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_silent_robot_fails_in_time_for_the_others_to_be_committed_without_it",
            ),
            Test(
                "scheduler/mission/src/act/timing.rs::a_commitment_has_the_lateness_of_this_machine_for_its_delivery",
            ),
        ],
    ),
    (
        Mission,
        "If clocks are so far off that the silence has to be longer than that, the act is not sent before \
         those robots have ended the other one.",
        &[Test(
            "scheduler/mission/src/tests/clocks.rs::an_act_that_needs_a_longer_silence_than_the_leases_of_another_is_sent_after_its_end",
        )],
    ),
    (
        Mission,
        "With `on_failure: stop`, the mission sends nothing but stops, and all leases end at the brink.",
        &[Test(
            "scheduler/mission/src/tests.rs::a_mission_that_stops_sends_no_script_that_an_act_still_wants",
        )],
    ),
    (
        Mission,
        "If the disk or this machine is too slow, no robot starts (`commitment_late`).",
        &[
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_slow_disk_withdraws_the_act_while_nothing_has_moved",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::a_process_that_stood_still_over_the_commitment_writes_none_down_afterwards",
            ),
        ],
    ),
    (
        Mission,
        "If this machine was too slow to start an act, nothing moves, and the mission withdraws the act.",
        &[
            Test(
                "scheduler/mission/src/tests/again.rs::an_act_that_was_withdrawn_before_anything_moved_is_prepared_again_with_a_longer_lead",
            ),
            Test(
                "tests/processes/missions/again.rs::a_scheduler_that_stalls_over_the_commitment_starts_all_robots_a_little_later",
            ),
        ],
    ),
    (
        Mission,
        "Once every robot has confirmed its stop, the mission prepares the act again, at most twice.",
        &[Test("scheduler/mission/src/tests/again.rs::an_act_is_prepared_again_twice_at_most")],
    ),
    (
        Mission,
        "No robot whose link is up is blamed for a missing acceptance if the disk left the robot less than \
         half of the time to prepare, or if the mission runs more than 20 ms late when it decides.",
        &[
            Test(
                "scheduler/mission/src/act/tests/preparing.rs::no_robot_is_blamed_for_the_time_that_the_disk_took",
            ),
            Test(
                "scheduler/mission/src/act/tests/preparing.rs::where_this_process_stood_still_nobody_is_blamed_for_acceptances_that_it_has_not_read",
            ),
        ],
    ),
    (
        Mission,
        "If all robots in the act are silent, the mission makes a third attempt before they count as \
         failed.",
        &[Test(
            "scheduler/mission/src/tests/again.rs::silent_robots_fail_at_the_second_attempt_or_at_the_third_if_all_robots_are_silent",
        )],
    ),
    (
        Mission,
        "The mission ends without another attempt if a robot has begun or does not confirm its stop, if \
         the act starts at a fixed time that `--start-within` does not extend, or if another act plays \
         and a robot of the new act does not declare `pending_until`.",
        &[
            Test("scheduler/mission/src/tests/again.rs::an_act_that_a_robot_has_begun_is_not_prepared_again"),
            Test(
                "scheduler/mission/src/tests/again.rs::an_act_is_not_prepared_again_if_a_robot_does_not_confirm_its_stop",
            ),
            Test(
                "scheduler/mission/src/tests/again.rs::an_act_with_an_instant_of_its_own_is_not_prepared_again",
            ),
            Test(
                "scheduler/mission/src/tests/again.rs::an_act_behind_another_one_stops_both_if_a_robot_may_keep_it_for_longer",
            ),
        ],
    ),
    (
        Mission,
        "After the commitment the rounds continue until all robots should have started.",
        &[Test(
            "scheduler/mission/src/act/tests/approaching.rs::after_the_commitment_rounds_continue_until_the_robots_have_started",
        )],
    ),
    (
        Mission,
        "They pause from a round trip and 1 ms before the planned start, 5 ms at most, until 1 ms after \
         it: messages would take cores from robots that start on this host.",
        &[Test("scheduler/mission/src/act/timing.rs::what_can_wait_is_not_sent_while_robots_start")],
    ),
    (
        Mission,
        "If not all robots have answered before the start, the report has no `window_ms`.",
        &[Test(
            "scheduler/mission/src/act/tests/approaching.rs::no_window_is_told_if_a_robot_has_not_answered_the_commitment_before_the_start",
        )],
    ),
    (
        Mission,
        "Only an inquiry extends `pending_until`.",
        &[Conformance("lease-until", "an inquiry lifts pending_until")],
    ),
    (
        Mission,
        "the scheduler dies before the commitment | all leases end at the brink | no robot starts",
        &[Test(
            "tests/processes/missions/processes.rs::if_the_scheduler_is_killed_before_the_commitment_none_starts",
        )],
    ),
    (
        Mission,
        "A failure that is known at start - early - 3 round trips - 20 ms is withdrawn before any robot \
         starts, as long as links keep to their usual delay.",
        &[Simulation('a', "02-known-failure-is-not-withdrawn")],
    ),
    (
        Mission,
        "A scheduler that stands still over that instant blames no robot: answers may have come that it \
         has not read, and a withdrawal would come too late.",
        &[Test(
            "scheduler/mission/src/act/tests/approaching.rs::a_process_that_stood_still_until_no_withdrawal_helps_blames_no_robot_whose_answer_it_has_not_read",
        )],
    ),
    (
        Mission,
        "The mission asks all robots at least once a second, and three times within the shortest lease.",
        &[Test(
            "scheduler/mission/src/tests/course.rs::robots_are_asked_three_times_a_lease_while_they_play",
        )],
    ),
    (
        Mission,
        "A robot that holds scripts of a committed act and owes an answer has failed if it stays silent \
         for its shortest running lease (3 s if it has none) plus a round trip.",
        &[Simulation('h', "04-silence-goes-unnoticed")],
    ),
    (
        Mission,
        "Whenever a place becomes free, the next script in order of start follows, of whichever act; \
         nothing overtakes a script that waits.",
        &[
            Test(
                "scheduler/mission/src/ledger/tests.rs::nothing_overtakes_a_script_that_waits_even_of_an_act_that_is_not_open",
            ),
            Test(
                "scheduler/mission/src/ledger/tests.rs::whatever_ends_lets_the_next_script_follow_of_whichever_act",
            ),
        ],
    ),
    (
        Mission,
        "A script that follows another one of its device waits under that script's running lease.",
        &[Simulation('c', "06-a-waiting-lease-ends-what-plays")],
    ),
    (
        Mission,
        "If a robot with `reports` does not report a start or an end within 500 ms and two round trips, \
         the mission asks it; if it stays silent for the same time again, it has failed.",
        &[Test(
            "scheduler/mission/src/act/tests/playing.rs::an_overdue_report_is_asked_for_and_then_its_robot_has_failed",
        )],
    ),
    (
        Mission,
        "This holds only once the robot has answered a question sent after the report was due, so a \
         scheduler that was suspended blames no robot.",
        &[Test(
            "scheduler/mission/src/tests/lost.rs::reports_that_arrived_while_this_machine_was_held_up_are_read_before_a_robot_is_blamed",
        )],
    ),
    (
        Mission,
        "If the robot answers inquiries, the answer has to report on the script; a robot that ignores \
         the script's name has failed after the same time.",
        &[Test(
            "scheduler/mission/src/tests/lost.rs::a_robot_that_only_answers_is_asked_about_its_script_after_this_machine_was_held_up",
        )],
    ),
    (
        Mission,
        "From a robot with neither, nothing can be learned: its script counts as over 15 ms, and the \
         amount by which its clock may be late, after the planned end.",
        &[Test(
            "scheduler/mission/src/act/tests/playing.rs::scripts_of_a_robot_that_tells_nothing_lapse_and_become_unknown",
        )],
    ),
    (
        Mission,
        "If a robot does not answer in time, or if the leases cannot be shortened, no robot starts \
         (`commitment_late`), and the mission does not blame a robot for its silence.",
        &[Test(
            "scheduler/mission/src/act/tests/approaching.rs::a_robot_that_fell_silent_while_this_machine_stood_still_over_the_last_rounds_keeps_the_act_from_starting",
        )],
    ),
    (
        Mission,
        "If the queue is still full, the robot refuses the next script, and the mission sends it again \
         within 50 ms or a round trip, whichever is longer.",
        &[Test(
            "scheduler/mission/src/script/tests.rs::a_script_that_is_refused_for_a_moment_is_planned_again_under_another_name",
        )],
    ),
    (
        Mission,
        "On the new link it asks what became of the robot's scripts, and sends a script again that the \
         robot never received.",
        &[
            Test(
                "tests/processes/stops/silence.rs::a_script_that_was_lost_with_the_link_while_acts_are_prepared_is_sent_again",
            ),
            Test(
                "tests/processes/stops/silence.rs::a_script_that_was_lost_with_the_link_while_others_play_is_sent_again_and_cancels_nothing",
            ),
        ],
    ),
    (
        Mission,
        "It sends scripts only once the robot has answered a question on the new link, because the answer \
         may come from a new process with another clock.",
        &[Test(
            "scheduler/mission/src/tests/clocks.rs::a_robot_that_is_back_with_the_same_clock_is_sent_what_waits_once_it_has_answered",
        )],
    ),
    (
        Mission,
        "If a clock turns out to have been set during an act, and a script that has not begun would \
         certainly start more than `start_tolerance` off its plan, the robot has failed (`clock`).",
        &[
            Test(
                "scheduler/mission/src/tests/clocks.rs::a_robot_that_is_back_with_another_clock_in_the_middle_of_an_act_fails_and_is_sent_no_script",
            ),
            Test(
                "scheduler/mission/src/tests/clocks.rs::a_robot_whose_clock_is_set_in_the_middle_of_an_act_fails_if_more_scripts_are_to_begin",
            ),
        ],
    ),
    (
        Mission,
        "If it never joins, or connects only after the last of its acts has begun, the mission is done \
         without it (`done_without`), and the report names it (`never_joined`).",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::a_robot_that_never_comes_or_comes_after_its_last_act_has_begun_was_left_out",
        )],
    ),
    (
        Mission,
        "The times in an answer decide how long all robots wait for each other, so only answers to open \
         questions count.",
        &[Test(
            "scheduler/mission/src/exchanges.rs::an_answer_counts_once_and_only_to_a_question_that_was_asked",
        )],
    ),
    (
        Mission,
        "All other answers, and control responses to requests that were never sent, are counted \
         (`ignored_answers` in the report) and mean nothing.",
        &[
            Test(
                "scheduler/mission/src/exchanges.rs::an_answer_counts_once_and_only_to_a_question_that_was_asked",
            ),
            Test(
                "tests/processes/security/flooding.rs::an_answer_to_a_question_that_was_never_asked_delays_nobody",
            ),
        ],
    ),
    (
        Mission,
        "Its link is closed, and the mission connects to it again only to stop it.",
        &[Test(
            "scheduler/mission/src/tests/hostile.rs::a_robot_that_floods_has_failed_and_is_connected_to_again_only_to_be_stopped",
        )],
    ),
    (
        Mission,
        "Of what comes on such a link, nothing is heard but the robot's description and its answers to \
         what was sent since, three to each request, and the link is closed again after 2 s.",
        &[Test(
            "scheduler/runtime/src/link/budget.rs::of_a_robot_that_has_flooded_only_the_answers_to_further_requests_are_heard_and_only_for_a_moment",
        )],
    ),
    (
        Mission,
        "Nothing that the robot says of that script counts any more, and the report's table shows the \
         starts of such a robot as `1/1 claimed`:",
        &[
            Test(
                "scheduler/mission/src/script/tests.rs::of_a_script_that_is_discredited_no_start_is_known_whatever_was_said_before_or_after",
            ),
            Test(
                "tests/processes/terminal/commands.rs::a_start_that_was_claimed_and_is_not_believed_is_not_called_a_start",
            ),
        ],
    ),
    (
        Mission,
        "`steps` | more steps than the script has | at most those",
        &[Test(
            "scheduler/mission/src/claim/tests.rs::a_script_has_no_more_steps_than_were_sent_and_its_end_no_fewer",
        )],
    ),
    (
        Mission,
        "`late_steps` | more late steps than steps done | at most those",
        &[Test(
            "scheduler/mission/src/claim/tests.rs::a_script_has_no_more_steps_than_were_sent_and_its_end_no_fewer",
        )],
    ),
    (
        Mission,
        "The same limit applies to every later step, because a robot with a late step is as far from the \
         others as one that starts late.",
        &[
            Test(
                "scheduler/mission/src/tests.rs::steps_that_are_as_late_as_is_tolerated_are_in_tolerance_and_those_of_robots_left_out_do_not_count",
            ),
            Test(
                "tests/processes/missions/told.rs::steps_that_were_later_than_is_tolerated_are_named_and_are_no_success",
            ),
        ],
    ),
    (
        Mission,
        "If it does not, the report only counts its late steps.",
        &[Test("scheduler/mission/src/script/tests.rs::steps_and_late_steps_never_become_fewer")],
    ),
    (
        Mission,
        "The journal keeps what prevents an ended act from being called `done`, for a process that \
         resumes the mission.",
        &[
            Test(
                "scheduler/runtime/src/journal/tests.rs::what_keeps_a_mission_from_being_called_done_is_known_of_acts_that_have_ended",
            ),
            Test(
                "scheduler/mission/src/tests/resumed.rs::a_flaw_of_an_act_that_ended_before_the_crash_is_in_the_outcome",
            ),
        ],
    ),
    (
        Mission,
        "The act's `on_failure` applies to all robots or to single ones: `stop`, the default, stops all \
         robots where they are, `home` stops them and moves them to their default positions, `without` \
         stops that robot where it is and continues; `then` names the act that follows once no robot can \
         still move.",
        &[
            Test(
                "scheduler/mission/src/tests/course.rs::a_failure_may_lead_to_another_act_once_all_are_at_rest",
            ),
            Test(
                "scheduler/mission/src/tests/course.rs::a_robot_of_its_own_policy_is_left_out_where_another_one_would_end_the_mission",
            ),
            Test(
                "scheduler/mission/src/tests/transfer.rs::after_a_failure_the_others_go_home_and_the_robot_that_failed_stays",
            ),
        ],
    ),
    (
        Mission,
        "A stop never starts a movement (protocol.md): a position that moves linearly slows down within \
         the acceleration that its device declares, any other position stays, speeds go to zero, and \
         custom values keep what they have unless their device declares `at_rest`.",
        &[Simulation('m', "17-a-stop-sends-robots-home")],
    ),
    (
        Mission,
        "A mission moves robots to their default positions only on request: `on_failure: home`, `downbeat \
         stop --home`, the key `H` of the display, or `home` typed at a terminal without a display.",
        &[Simulation('m', "17-a-stop-sends-robots-home")],
    ),
    (
        Mission,
        "All robots come to rest first.",
        &[Test(
            "scheduler/mission/src/tests/transfer.rs::robots_come_to_rest_and_then_play_the_way_home_that_was_planned_from_their_positions",
        )],
    ),
    (
        Mission,
        "The act keeps the limits of the block and the fleet file, and avoids collisions as far as bodies \
         are known.",
        &[
            Test("scripts/src/home.rs::devices_move_within_their_limits_to_their_default_positions"),
            Test("scripts/src/home.rs::a_way_home_that_would_collide_with_a_robot_that_stays_is_refused"),
        ],
    ),
    (
        Mission,
        "Only devices that the mission has moved, and that have a `default_value`, take part.",
        &[
            Test(
                "scheduler/mission/src/tests/transfer.rs::the_way_home_is_planned_only_for_devices_that_the_mission_has_moved",
            ),
            Test("scripts/src/home.rs::a_device_without_a_default_position_does_not_go_home"),
        ],
    ),
    (
        Mission,
        "If a robot has failed, does not answer inquiries, or has lost its link, it stays where it is.",
        &[
            Test(
                "scheduler/mission/src/tests/transfer.rs::after_a_failure_the_others_go_home_and_the_robot_that_failed_stays",
            ),
            Test(
                "scheduler/mission/src/tests/transfer.rs::a_robot_that_is_gone_does_not_keep_the_others_from_home",
            ),
        ],
    ),
    (
        Mission,
        "If a robot has not confirmed its stop and may still move, all robots stay where they are.",
        &[Test(
            "scheduler/mission/src/tests/transfer.rs::as_long_as_a_robot_may_still_move_nobody_goes_home",
        )],
    ),
    (
        Mission,
        "If the operator says stop during the act, all robots come to rest again.",
        &[Test(
            "scheduler/mission/src/tests/transfer.rs::a_stop_on_the_way_home_leaves_the_robots_where_they_are_and_a_second_home_changes_nothing",
        )],
    ),
    (
        Mission,
        "The approach moves devices to the first positions in the act that follows and in the acts after \
         it.",
        &[Simulation('m', "21-the-act-after-a-failure-jumps")],
    ),
    (
        Mission,
        "A robot goes home on its own, at its own speed and without regard to the others, only if the \
         scheduler has ended or does not answer, and `downbeat stop --home` has only the journal.",
        &[
            Test(
                "scheduler/mission/src/tests/transfer.rs::robots_come_to_rest_and_then_play_the_way_home_that_was_planned_from_their_positions",
            ),
            Test(
                "tests/processes/missions/rest.rs::a_stop_leaves_every_robot_where_it_is_and_says_so_and_one_that_says_home_does_not",
            ),
        ],
    ),
    (
        Mission,
        "Every device that was sent anything gets an empty script.",
        &[Test(
            "scheduler/runtime/src/stop_lane/sent.rs::a_stop_goes_to_every_device_that_was_sent_anything_and_takes_back_all_of_it",
        )],
    ),
    (
        Mission,
        "A stop ends when all robots have confirmed it and reported the fate of their scripts, or when \
         `--patience` ends.",
        &[Falsified('h', "a_stop_that_is_not_heard_of_or_does_not_arrive_is_found")],
    ),
    (
        Mission,
        "A second Ctrl-C ends the process at once, or after 10 s if something keeps it alive; after \
         another signal or the key `s`, the first Ctrl-C counts as the second.",
        &[
            Test(
                "tests/processes/missions/processes.rs::a_second_ctrl_c_leaves_at_once_and_says_what_was_left_running",
            ),
            Test("scheduler/runtime/src/stop_lane/words.rs::only_a_second_ctrl_c_leaves"),
        ],
    ),
    (
        Mission,
        "A separate thread (`scheduler/runtime/src/stop_lane/`) listens to the signals and the mission's socket, \
         keeps a connection to every robot, and knows which devices were sent anything.",
        &[Test("tests/processes/stops/stops.rs::ctrl_c_stops_every_robot_whatever_else_stands_still")],
    ),
    (
        Mission,
        "On a stop it writes to all robots at once; from then on nothing that moves leaves the process.",
        &[Test("tests/processes/stops/stops.rs::ctrl_c_stops_every_robot_whatever_else_stands_still")],
    ),
    (
        Mission,
        "The lane itself only brings robots to rest.",
        &[Test(
            "scheduler/runtime/src/stop_lane/sent.rs::a_stop_goes_to_every_device_that_was_sent_anything_and_takes_back_all_of_it",
        )],
    ),
    (
        Mission,
        "the terminal, or a pipe that nothing reads | stop at once | continues, because its output waits \
         in a queue (display.md); at the end it gives up the report when nothing can be written for 3 s",
        &[
            Test("tests/processes/stops/stops.rs::ctrl_c_stops_every_robot_whatever_else_stands_still"),
            Test("tests/processes/terminal/output.rs::a_terminal_that_stands_still_holds_up_no_mission"),
        ],
    ),
    (
        Mission,
        "the disk, before anything was sent | have nothing to stop | a stop ends the process: \"nothing \
         was sent\"",
        &[Test(
            "tests/processes/stops/stops/standstill.rs::a_disk_that_stands_still_before_the_mission_has_begun_does_not_keep_the_operator_from_ending_it",
        )],
    ),
    (
        Mission,
        "If the file was removed, moved or replaced, the thread writes the whole journal there again, in \
         folders and a file that only you can access, and locks it.",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::a_journal_that_is_removed_or_moved_or_cut_short_is_written_again_under_its_lock",
        )],
    ),
    (
        Mission,
        "Only then do its records count as being on the disk.",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::the_thread_writes_a_removed_journal_again_before_its_records_are_durable",
        )],
    ),
    (
        Mission,
        "`downbeat stop`, `go` and `missions` therefore find the mission again within half a second; \
         until then, they report that no mission runs.",
        &[Test(
            "tests/processes/stops/removed.rs::a_mission_whose_state_folder_is_removed_says_so_and_is_stopped_by_downbeat_stop",
        )],
    ),
    (
        Mission,
        "A file that was moved away stays locked, so the mission cannot be resumed from there.",
        &[Test(
            "tests/processes/stops/removed.rs::a_mission_whose_state_folder_is_moved_away_is_listed_and_stopped_at_its_old_place",
        )],
    ),
    (
        Mission,
        "If the journal cannot be written again, for example because another file is in its place, the \
         mission stops all robots (`journal_lost`).",
        &[Test(
            "tests/processes/stops/removed.rs::a_mission_that_cannot_write_its_journal_again_stops_its_robots",
        )],
    ),
    (
        Mission,
        "Every other signal that stops a mission stops robots where they are, also on the way to their \
         default state, so a lost terminal or a supervisor moves none.",
        &[Test("tests/processes/missions/rest.rs::a_lost_terminal_moves_no_robot_that_is_stopped")],
    ),
    (
        Mission,
        "SIGUSR1, SIGUSR2, SIGXFSZ, SIGIO, SIGSTKFLT and the signals of timers do nothing: a file that \
         has reached its limit is a write error.",
        &[Test(
            "tests/processes/stops/stops/scheduler_signals.rs::signals_that_ask_for_nothing_do_not_end_a_mission",
        )],
    ),
    (
        Mission,
        "Only its user can read it, and journals of other users are refused (security.md).",
        &[
            Test(
                "scheduler/runtime/src/journal/private.rs::folders_and_files_are_created_for_this_user_alone",
            ),
            Test(
                "scheduler/runtime/src/journal/private.rs::what_belongs_to_another_user_is_refused_and_named",
            ),
        ],
    ),
    (
        Mission,
        "Promises and commitments are on disk before the mission continues.",
        &[
            Test(
                "scheduler/mission/src/act/tests/preparing.rs::nothing_is_sent_before_the_promise_is_on_the_disk",
            ),
            Test(
                "scheduler/mission/src/act/tests/approaching.rs::the_commitment_is_on_the_disk_before_any_robot_is_told",
            ),
        ],
    ),
    (
        Mission,
        "one act is only promised (`prepared`) | withdraws everything",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::a_mission_that_was_cut_off_can_be_resumed_if_all_that_it_promised_was_decided",
        )],
    ),
    (
        Mission,
        "`decided` | commits the act, if there is time for the whole approach with the leases as sent; \
         otherwise withdraws it (`commitment_late`), and blames no robot that it had no time to ask",
        &[
            Test(
                "scheduler/mission/src/act/tests/resumed.rs::an_act_that_was_only_decided_is_committed_if_there_is_time_and_else_withdrawn",
            ),
            Test(
                "scheduler/mission/src/act/tests/resumed.rs::no_robot_is_blamed_for_a_process_that_took_over_too_late_to_ask_it",
            ),
        ],
    ),
    (
        Mission,
        "ends in an incomplete line | cuts off that line under the journal's lock.",
        &[Simulation('g', "09-a-torn-journal-hides-what-follows")],
    ),
    (
        Mission,
        "whole lines follow a damaged one | withdraws everything, also what only those lines name",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::robots_that_only_lines_after_the_damage_name_are_withdrawn_as_well",
        )],
    ),
    (
        Mission,
        "If an act ended while no scheduler ran and the mission is stopped afterwards, the act is \
         `played` if a robot completed it, and `unknown` if no robot reports on it.",
        &[Test(
            "scheduler/mission/src/tests/resumed.rs::an_act_that_ended_while_no_process_drove_it_was_not_stopped",
        )],
    ),
    (
        Mission,
        "If no robot can have moved, `failed` becomes `not_started`.",
        &[Test(
            "scheduler/mission/src/tests/resumed.rs::a_withdrawn_mission_has_failed_if_anything_may_have_moved_and_has_not_started_otherwise",
        )],
    ),
    (
        Mission,
        "If all robots have confirmed their stop, `resume` ends with the exit code of the outcome, and \
         `downbeat stop` with 0.",
        &[
            Test(
                "tests/processes/missions/resumed.rs::a_mission_that_an_operator_stops_after_a_crash_was_stopped",
            ),
            Test(
                "tests/processes/missions/resumed.rs::a_mission_without_an_act_under_way_is_withdrawn_as_failed",
            ),
        ],
    ),
    (
        Mission,
        "A robot obeys every party that names the session to which it belongs.",
        &[Test("robot/src/robot/tests/sessions.rs::a_session_goes_on_on_another_link")],
    ),
    (
        Mission,
        "Two schedulers never drive one robot: a robot belongs to one session until that session ends, \
         and refuses every other one with `busy`, without naming the session that has it.",
        &[
            Conformance("session", "sessions are not known"),
            Test(
                "tests/processes/missions/missions.rs::a_robot_that_belongs_to_a_mission_is_refused_to_a_second_by_name",
            ),
        ],
    ),
    (
        Mission,
        "It stops all robots of the fleet with `tls://` or `hmac://` addresses, in missions of all \
         operators, if your certificate or pass has the role `stop` (security.md).",
        &[Test(
            "tests/processes/security/tls.rs::who_may_stop_stops_the_missions_of_others_and_is_named_in_their_reports",
        )],
    ),
    (
        Mission,
        "Robots with `tcp://` addresses obey it only while they belong to no session.",
        &[Conformance("session-stop", "anybody may stop")],
    ),
    (
        Mission,
        "A robot that was taken may still slow down: as long as a device does not stand where its first \
         keyframe expects it, the mission reads its position again, for at most 4 s.",
        &[Test(
            "scheduler/mission/src/tests/greeting.rs::a_robot_that_was_taken_and_still_moves_is_read_again_for_at_most_four_seconds",
        )],
    ),
    (
        Mission,
        "It does not send that stop again, so nothing stops the robot behind the other mission.",
        &[Test(
            "scheduler/mission/src/tests/stops.rs::a_robot_that_another_session_has_taken_over_is_left_to_that_unless_the_operator_wants_it_to_stop",
        )],
    ),
    (
        Mission,
        "If its process does not answer within a second, or has no socket, `downbeat stop` stops the \
         robots directly, under the mission's session, and sends SIGTERM to the process (SIGRTMIN+1 with \
         `--home`).",
        &[
            Test(
                "tests/processes/stops/stop_command.rs::the_robots_of_a_scheduler_that_stands_still_are_stopped_directly",
            ),
            Test(
                "tests/processes/stops/stop_command.rs::a_mission_without_a_socket_is_stopped_directly_and_ends",
            ),
        ],
    ),
    (
        Mission,
        "It stops every robot of the journal at the address at which the robot was sent its scripts, and \
         lists it.",
        &[Test(
            "tests/processes/stops/stop_command.rs::after_a_crash_robots_are_stopped_at_the_addresses_at_which_they_were_sent_their_scripts",
        )],
    ),
    (
        Mission,
        "A mission that was cut off has ended only when all its robots have confirmed.",
        &[Test(
            "tests/processes/stops/stop_command.rs::a_mission_of_which_a_robot_did_not_confirm_can_be_stopped_again",
        )],
    ),
    (
        Mission,
        "For a lease that no stop reaches, the instant of its end is counted from the first stop, because \
         nothing renews it after that; a second stop names the same instant.",
        &[Test(
            "tests/processes/stops/stop_command.rs::a_second_stop_names_the_same_instant_at_which_a_lease_ends",
        )],
    ),
    (
        Mission,
        "If there is nothing to stop, it is `{\"error\": ...}`, or `[]` with `--all`.",
        &[Test(
            "tests/processes/terminal/commands.rs::where_nothing_runs_stop_and_go_print_a_document_in_json",
        )],
    ),
    (
        Mission,
        "It can be tested without being taken (an open file description lock on `journal`; a lock by \
         `flock` means nothing to it).",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::a_lock_of_another_kind_does_not_keep_a_journal_shut",
        )],
    ),
    (
        Mission,
        "When a mission begins, it keeps the folders of the last 50 ended missions, and of fewer if their \
         journals are longer than 64 MiB together; it removes older ones.",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::old_journals_are_limited_in_number_and_size_and_one_that_has_not_ended_stays",
        )],
    ),
    (
        Mission,
        "A mission that has not ended stays until it is resumed or stopped.",
        &[Test(
            "scheduler/runtime/src/journal/tests.rs::old_journals_are_limited_in_number_and_size_and_one_that_has_not_ended_stays",
        )],
    ),
    (
        Mission,
        "Only `ended`, stated by the robot itself, counts towards `done`.",
        &[Test(
            "tests/processes/missions/refills.rs::robots_that_report_nothing_and_miss_a_value_are_not_done",
        )],
    ),
    (
        Mission,
        "For a robot that takes no inquiries, such a script stays `unknown` if the robot reported to the \
         process that died, or if it now refuses the script as too late.",
        &[
            Test(
                "scheduler/mission/src/act/tests/resumed.rs::what_a_robot_that_cannot_be_asked_reported_to_the_process_before_ends_unknown_by_its_time",
            ),
            Test(
                "scheduler/mission/src/act/tests/resumed.rs::what_a_robot_refuses_as_too_late_may_have_been_played_where_another_process_may_have_sent_it",
            ),
        ],
    ),
    (
        Mission,
        "A stopped robot is `confirmed` (it comes to rest where it is), `home` (it is at its default \
         positions, or goes there on its own), `taken_over` (it already belongs to another mission, so it \
         refused the stop and holds nothing of this mission) or `unconfirmed`.",
        &[
            Test(
                "tests/processes/missions/rest.rs::a_stop_leaves_every_robot_where_it_is_and_says_so_and_one_that_says_home_does_not",
            ),
            Test(
                "tests/processes/stops/stop_command.rs::a_mission_of_which_a_robot_did_not_confirm_can_be_stopped_again",
            ),
            Test(
                "tests/processes/security/seize.rs::who_may_seize_takes_robots_from_a_mission_and_others_do_not",
            ),
        ],
    ),
    (
        Mission,
        "3 | stopped by the operator, every robot confirmed it | `stopped`",
        &[Test("tests/processes/missions/processes.rs::ctrl_c_stops_every_robot")],
    ),
    (
        Mission,
        "5 | done, but without robots that failed on the way or never joined, or without acts whose wait \
         timed out | `done_without`, `done_skipping`",
        &[
            Test(
                "tests/processes/missions/missions.rs::a_robot_that_never_comes_is_named_and_the_mission_is_done_without_it",
            ),
            Test(
                "tests/processes/missions/course.rs::an_act_whose_sensor_never_reads_what_it_waits_for_is_skipped_and_the_mission_is_not_simply_done",
            ),
        ],
    ),
    (
        Mission,
        "Code 7 comes only in place of 0: a mission that failed keeps its own code, even if its output is \
         lost.",
        &[Test("tests/processes/terminal/output.rs::output_on_a_full_disk_hides_no_other_failure")],
    ),
    (
        Mission,
        "`course` contains every act of the scenario: `played` (and how often), `timed_out` (with what it \
         waited for), `nobody_left`, `withdrawn`, `stopped`, `unknown` (none of its robots said what \
         became of it), `still_waiting` or `not_reached`.",
        &[
            Test("tests/processes/missions/course.rs::acts_that_are_all_played_are_done"),
            Test(
                "tests/processes/missions/course.rs::an_act_whose_sensor_never_reads_what_it_waits_for_is_skipped_and_the_mission_is_not_simply_done",
            ),
        ],
    ),
    (
        Mission,
        "To allow enough corrections, the compiler cuts the scripts of these robots after about 30 s, and \
         a device whose scripts have leases holds only two of them at a time.",
        &[
            Test("scripts/src/compile/cut.rs::movements_are_cut_at_rests_into_scripts_of_about_one_length"),
            Test(
                "scheduler/mission/src/ledger/tests.rs::with_a_measured_clock_two_long_scripts_are_ahead_of_one_that_is_sent",
            ),
        ],
    ),
    (
        Mission,
        "A robot whose clock was set meanwhile is not judged, and in an act that was resumed, robots are \
         compared only with each other.",
        &[
            Test(
                "scheduler/mission/src/act/tests/drift.rs::a_robot_whose_clock_was_set_meanwhile_is_not_judged",
            ),
            Test(
                "scheduler/mission/src/act/tests/drift.rs::in_an_act_that_was_resumed_robots_are_compared_only_with_each_other",
            ),
        ],
    ),
    (
        Mission,
        "A process that resumes an act continues with the offsets in the journal, and changes them by at \
         most 100 ppm.",
        &[Test(
            "scheduler/mission/src/act/tests/resumed.rs::offsets_continue_from_those_in_the_journal_no_faster_than_clocks_drift",
        )],
    ),
    (
        Mission,
        "The robot's clock may be off by the offset shown next to the error; this offset is known to \
         within the uncertainty shown.",
        &[Test(
            "scheduler/mission/src/clock/tests.rs::the_true_offset_lies_within_the_uncertainty_whatever_the_delays_and_the_drift",
        )],
    ),
    (
        Protocol,
        "`tests/vectors/`: valid and invalid messages as files, with the verdict and the code that each \
         must get",
        &[
            Test("tests/documents/vectors.rs::invalid_lines_are_refused_and_say_whom_an_answer_concerns"),
            Test("tests/documents/vectors.rs::the_robot_answers_the_requests_as_listed"),
        ],
    ),
    (
        Protocol,
        "Accept at least two connections at a time, as the conformance test demands, and preferably \
         three: a server has one for the mission and keeps one for a stop, and another server may have to \
         stop your robot.",
        &[Conformance("two-links", "one connection at a time")],
    ),
    (
        Protocol,
        "A stop never starts a movement (*Coming to rest*).",
        &[Conformance("stays-stopped", "a stop goes to the default state")],
    ),
    (
        Protocol,
        "Steps 1 to 4 may be skipped (P): a robot must accept a control request as the first message of a \
         connection.",
        &[Conformance("skip-handshake", "a peer that does not greet is disconnected")],
    ),
    (
        Protocol,
        "A robot ignores messages that only a robot sends, and need not look into them.",
        &[Test(
            "robot/src/robot/tests/instants.rs::an_initialization_request_is_answered_with_the_block_and_a_robots_own_message_not_at_all",
        )],
    ),
    (
        Protocol,
        "Servers must understand other offsets from UTC, and robots may.",
        &[Test("tests/documents/vectors.rs::valid_messages_are_read_and_written_again")],
    ),
    (
        Protocol,
        "The robot answers a line that is not a message, and the line changes nothing: no lease is \
         renewed, nothing starts or ends, and the connection stays open.",
        &[
            Conformance("lease-noise", "noise renews"),
            Conformance("malformed-line", "what is not JSON is hung up on"),
        ],
    ),
    (
        Protocol,
        "The server asks several times, and again during a mission: every message renews leases.",
        &[Conformance("lease-renewal", "availability requests renew nothing")],
    ),
    (
        Protocol,
        "`id` | id | yes | P | unique within the robot",
        &[Test("tests/documents/vectors.rs::invalid_lines_are_refused_and_say_whom_an_answer_concerns")],
    ),
    (
        Protocol,
        "`default_value` | number | no | D | where it is in its default state, see *Coming to rest*: by \
         the first of position, speed, acceleration and custom_N that it has, and within the range of \
         that",
        &[
            Conformance("initialization", "the default value lies out of range"),
            Conformance("home-position", "home is a stop"),
        ],
    ),
    (
        Protocol,
        "A server sends it what it sends so much earlier; the robot itself does nothing with it",
        &[Test(
            "tests/processes/clocks/latency.rs::a_robot_that_moves_60_ms_late_is_commanded_60_ms_earlier",
        )],
    ),
    (
        Protocol,
        "Only with `latency`",
        &[Test(
            "protocol/src/message/latency.rs::a_latency_is_a_number_of_milliseconds_and_its_spread_needs_it",
        )],
    ),
    (
        Protocol,
        "`script` | a sequence of the others in one command | the same; what is left out is inherited \
         from the control type that the script supports, unless it supports several that differ (D); and \
         `max_number_of_steps` (integer, at least 1, required); `control_types` (D, list): those of the \
         device that its steps may use, otherwise every one of the device but script and sensor",
        &[Test(
            "protocol/src/message/control_types.rs::a_script_inherits_what_it_leaves_out_unless_the_control_types_that_it_supports_differ",
        )],
    ),
    (
        Protocol,
        "Without `at_rest`, a custom_N keeps its values when the device comes to rest, because only its \
         maker knows which values are safe (D).",
        &[Test(
            "robot/src/robot/tests/hardware.rs::a_custom_type_goes_to_what_it_declares_once_a_command_has_driven_it_and_stays_otherwise",
        )],
    ),
    (
        Protocol,
        "`control_value` | number; for `script` the list of its steps; for `sensor` nothing, and what is \
         there is ignored; for a control type that the protocol does not know anything, also a list or a \
         text | yes | P | what to set",
        &[
            Test(
                "protocol/src/wire_tests.rs::an_unknown_control_type_is_a_request_whatever_its_values_are_and_wherever_they_stand",
            ),
            Conformance("unknown-control-type", "an unknown control type with a list or a text is malformed"),
        ],
    ),
    (
        Protocol,
        "`request_id` | string | no | D | echoed in every answer; see *Asked twice*",
        &[Conformance("request-id", "answers name no request")],
    ),
    (
        Protocol,
        "`time_offset_to_start` | number, ms | yes | D | from the script's own start; never less than the \
         step ahead of it",
        &[Conformance("script-order", "steps are put in order")],
    ),
    (
        Protocol,
        "The two instants differ only if a device with `hold` plays a script whose first step is due \
         after its start.",
        &[Conformance("script-start", "a script is reported as started before its first value")],
    ),
    (
        Protocol,
        "When it comes again, the robot ignores everything else in the second request, sends its last \
         answer again with a new `timestamp`, and does nothing else.",
        &[Conformance("repeated-request", "repeated requests are executed again")],
    ),
    (
        Protocol,
        "The robot keeps the last answers of all requests that have not ended, and of at least 256 that \
         have.",
        &[Conformance("kept-answers", "eight answers are kept")],
    ),
    (
        Protocol,
        "A server that sends `content_hash` in JSON must send `control_value` in exactly this form, so a \
         robot may hash the bytes as they came.",
        &[Test("protocol/src/wire_tests.rs::the_papers_script_is_one_request_byte_for_byte")],
    ),
    (
        Protocol,
        "The robot executes nothing of a refused request.",
        &[Conformance("script-range", "steps out of range are cut to it")],
    ),
    (
        Protocol,
        "7 | a script has at most `max_number_of_steps` | `too_many_steps` | P",
        &[Conformance("one-step-too-many", "fewer steps are declared than it takes")],
    ),
    (
        Protocol,
        "10 | the value lies within `min_value` to `max_value` of its control type, in a script also of \
         the script's own | `out_of_range` | P",
        &[Conformance("range", "less is declared than it takes")],
    ),
    (
        Protocol,
        "A sensor's request claims nothing.",
        &[Test("robot/src/robot/tests/sessions.rs::a_reading_claims_nothing")],
    ),
    (
        Protocol,
        "An empty script skips 6 to 16: every device accepts it.",
        &[Test("robot/src/robot/tests/sessions.rs::every_device_accepts_an_empty_script")],
    ),
    (
        Protocol,
        "A stop never starts a movement, because people next to the robot expect none.",
        &[Conformance("stays-stopped", "a stop goes to the default state")],
    ),
    (
        Protocol,
        "position of a device with `linear` | slows down within the `acceleration` that the device \
         declares, and stays there.",
        &[
            Test("robot/src/robot/tests/sessions.rs::where_an_acceleration_is_declared_a_stop_decelerates"),
            Test("robot/src/signal.rs::coming_to_rest_keeps_to_the_acceleration_and_the_speed"),
        ],
    ),
    (
        Protocol,
        "The device brakes harder only if it would otherwise pass its limits.",
        &[Test("robot/src/signal.rs::a_standstill_beyond_the_limits_is_avoided_by_braking_harder")],
    ),
    (
        Protocol,
        "Without an `acceleration`, the position keeps the value that it has at that instant",
        &[Test("robot/src/robot/tests.rs::a_linear_device_without_default_value_holds_where_it_is_stopped")],
    ),
    (
        Protocol,
        "position of a device with `hold` | keeps its last value",
        &[Test("robot/src/robot/tests.rs::an_empty_script_now_ends_what_runs_and_moves_nothing")],
    ),
    (
        Protocol,
        "speed, acceleration | go to zero: a speed within the `acceleration` that the device declares, \
         otherwise at once",
        &[
            Test("robot/src/robot/tests/sessions.rs::where_an_acceleration_is_declared_a_stop_decelerates"),
            Test("robot/src/signal.rs::a_speed_is_slowed_in_the_time_that_its_acceleration_takes"),
            Test(
                "robot/src/robot/tests/instants.rs::a_device_that_is_stopped_keeps_its_position_and_turns_no_more_and_goes_home_only_if_it_is_told_to",
            ),
        ],
    ),
    (
        Protocol,
        "Without `at_rest` it keeps its values",
        &[Test(
            "robot/src/robot/tests/hardware.rs::a_custom_type_goes_to_what_it_declares_once_a_command_has_driven_it_and_stays_otherwise",
        )],
    ),
    (
        Protocol,
        "A value that no command has driven since the robot started stays as it is.",
        &[Test("robot/src/robot/tests/hardware.rs::hardware_that_nothing_was_set_on_is_left_as_it_is")],
    ),
    (
        Protocol,
        "Starting a robot, or connecting to it again, moves nothing either.",
        &[Conformance("stays-connected", "a new connection goes to the default state")],
    ),
    (
        Protocol,
        "Only two requests send a device to its default state: a command with a control type that the \
         device lacks (P), and an empty script with `home: true` (*Cancelling*).",
        &[
            Conformance(
                "lease-stays-pending",
                "a lease that ends before the start goes to the default state",
            ),
            Conformance("lease-stays-running", "a lease that ends after the start goes to the default state"),
        ],
    ),
    (
        Protocol,
        "`forbidden` | an availability response or inquiry response: the peer's certificate or pass lacks \
         the role, or nothing is proven on the connection and `seize` needs that, see security",
        &[
            Test("robot/src/robot/tests/sessions.rs::an_operator_does_what_its_roles_allow_and_nothing_else"),
            Test("robot/src/robot/tests/seizing.rs::who_may_not_seize_changes_nothing"),
        ],
    ),
    (
        Protocol,
        "Steps run on absolute deadlines, start + the step's own offset, so errors never add up.",
        &[Test(
            "robot/src/robot/tests/instants.rs::steps_keep_their_absolute_deadlines_when_the_driver_wakes_late",
        )],
    ),
    (
        Protocol,
        "A command without length (a single value, or a script of one step at 0) may be at the edges of \
         others, but not within them.",
        &[
            Test(
                "robot/src/robot/tests/instants.rs::a_set_into_a_script_that_has_begun_overlaps_even_at_its_first_instant",
            ),
            Test("robot/src/robot/tests/instants.rs::a_set_at_the_end_of_a_script_follows_it"),
        ],
    ),
    (
        Protocol,
        "A command that does not state a start begins on receipt and is never late.",
        &[Conformance("immediate-start", "at once means in half a second")],
    ),
    (
        Protocol,
        "A lease that ends exactly at the instant of a start wins: nothing starts.",
        &[Test("robot/src/robot/tests.rs::a_lease_that_ends_at_the_very_instant_of_the_start_wins")],
    ),
    (
        Protocol,
        "If a robot is delayed, for example because its process is stopped, until the lease of a running \
         command has ended, it does nothing that was due before.",
        &[Test(
            "robot/src/robot/tests/instants.rs::a_robot_that_was_held_up_beyond_its_lease_does_no_step_that_was_due_before",
        )],
    ),
    (
        Protocol,
        "`stop_condition` guards against a broken link (P): a robot that was told to hold 10 m/s must not \
         continue forever.",
        &[Conformance("lease-running", "stop_condition is not read")],
    ),
    (
        Protocol,
        "The time counts from the acceptance, and every message of the same session (without sessions: on \
         the same connection) restarts it.",
        &[
            Conformance("lease-renewal", "availability requests renew nothing"),
            Conformance("lease-two-links", "any connection renews"),
        ],
    ),
    (
        Protocol,
        "Silence before the start still counts after it: if the limit that applies after a start or a \
         step would be over by then, nothing starts, and the step is not done.",
        &[Conformance("lease-silence", "leases count from the start")],
    ),
    (
        Protocol,
        "When the lease of a command that has not begun ends, the device discards that command and every \
         other one that has not begun and starts at the same instant or later.",
        &[Test(
            "robot/src/robot/tests/leases.rs::the_end_of_a_pending_lease_takes_what_starts_later_with_it_and_leaves_what_starts_before",
        )],
    ),
    (
        Protocol,
        "A running command continues under its own lease, and so does one that starts earlier.",
        &[Conformance("lease-queued", "the end of a pending lease ends what runs")],
    ),
    (
        Protocol,
        "A command that has not begun has moved nothing, and its end moves nothing: the device stays \
         where it is.",
        &[Conformance("lease-stays-pending", "a lease that ends before the start goes to the default state")],
    ),
    (
        Protocol,
        "This is the only report that may follow an end.",
        &[Test(
            "robot/src/robot/tests/leases.rs::the_only_report_after_an_end_is_that_of_a_rate_left_on_whose_lease_ends",
        )],
    ),
    (
        Protocol,
        "It continues only if every robot holds its scripts.",
        &[Simulation('g', "13-decides-without-all-acceptances")],
    ),
    (
        Protocol,
        "An inquiry is a question that cannot act: it starts, stops and moves nothing, cancels nothing \
         and claims nothing.",
        &[
            Conformance("inquiry-no-effect", "an inquiry about something unknown cancels"),
            Conformance("inquiry-session", "an inquiry claims the robot"),
        ],
    ),
    (
        Protocol,
        "`timestamp` | timestamp | no | D | T1, as in an availability request: every inquiry is a clock \
         sample too",
        &[
            Conformance("inquiry", "the time of an inquiry is not echoed"),
            Conformance("inquiry", "an inquiry is answered by a clock that is behind"),
        ],
    ),
    (
        Protocol,
        "`requests` | list of strings | no, none | D | each `request_id` that is asked about, at most \
         32,000",
        &[Test(
            "protocol/src/wire_tests.rs::thirty_two_thousand_names_in_an_inquiry_are_taken_and_one_more_is_not",
        )],
    ),
    (
        Protocol,
        "`devices` | list of ids | no, none | D | the devices whose room and position the server wants to \
         know, at most 32,000",
        &[Test(
            "protocol/src/wire_tests.rs::thirty_two_thousand_names_in_an_inquiry_are_taken_and_one_more_is_not",
        )],
    ),
    (
        Protocol,
        "`pending_until` | timestamp | no | D | by the robot's clock: until when leases reach at most, \
         see below",
        &[Conformance("lease-inquiry-until", "pending_until is never moved")],
    ),
    (
        Protocol,
        "`state` | `unknown`, `held`, `running`, `ended` | yes | D | `unknown`: it never came, has been \
         forgotten, or the robot has restarted since.",
        &[Test("robot/src/robot/tests/inquiries.rs::a_request_is_unknown_then_held_then_running_then_ended")],
    ),
    (
        Protocol,
        "A free robot answers every inquiry and remains free.",
        &[Conformance("inquiry-session", "an inquiry claims the robot")],
    ),
    (
        Protocol,
        "Like every message, an inquiry renews the leases of the session, or connection, that sends it, \
         and no others.",
        &[
            Conformance("lease-inquiry", "inquiries renew nothing"),
            Test(
                "robot/src/robot/tests/inquiries.rs::an_inquiry_renews_the_leases_of_its_party_and_of_no_other",
            ),
        ],
    ),
    (
        Protocol,
        "It is never lengthened.",
        &[Test(
            "robot/src/robot/tests/inquiries.rs::a_pending_lease_is_shortened_for_what_is_named_and_never_lengthened",
        )],
    ),
    (
        Protocol,
        "The addition is small, and only with it can a server guarantee that no request starts without \
         its decision.",
        &[
            Test(
                "robot/src/robot/tests/inquiries.rs::what_nobody_has_confirmed_by_its_pending_until_never_starts",
            ),
            Test(
                "scheduler/simulation/src/tests.rs::a_request_that_arrives_while_the_scheduler_stalls_starts_nothing",
            ),
        ],
    ),
    (
        Protocol,
        "A `timestamp` ahead of the robot's clock counts as at most 250 ms ahead, and for a session that \
         claims the free robot after the stop as the instant of the claim, so that no stop closes the \
         device to the next session; for what the same session (without sessions: the same connection) \
         has sent, as at most 5 s ahead",
        &[
            Test(
                "robot/src/robot/tests.rs::a_stop_by_a_clock_that_is_far_ahead_takes_back_five_seconds_and_no_more",
            ),
            Test(
                "robot/src/robot/tests/sessions.rs::a_stop_with_a_timestamp_of_the_future_does_not_close_a_device_to_the_next_session",
            ),
        ],
    ),
    (
        Protocol,
        "The `OK` says that nothing of it continues, not that the device has come to rest or has arrived.",
        &[Conformance("cancel-running", "what runs is not stopped")],
    ),
    (
        Protocol,
        "The robot answers a request of type `sensor` with `Provide` and the reading in `status_value` \
         (P), within `max_delay`, or with `Failed`.",
        &[Test(
            "robot/src/robot/tests/hardware.rs::a_reading_that_does_not_come_fails_and_comes_too_late_afterwards",
        )],
    ),
    (
        Protocol,
        "The request moves nothing, belongs to no session and is not held.",
        &[
            Test("robot/src/robot/tests/sessions.rs::a_reading_claims_nothing"),
            Test(
                "robot/src/robot/tests.rs::a_reading_asked_for_twice_is_read_twice_and_takes_no_request_id_from_anybody",
            ),
        ],
    ),
    (
        Protocol,
        "The first session that is named owns the robot; an inquiry claims nothing.",
        &[
            Conformance("session", "sessions are not known"),
            Conformance("inquiry-session", "an inquiry claims the robot"),
        ],
    ),
    (
        Protocol,
        "It never says to which session it belongs: that name is a secret of those that use it, because a \
         peer that knows it can stop the robot, renew leases and divert reports.",
        &[Conformance("session", "who has the robot is told")],
    ),
    (
        Protocol,
        "A robot that is never told a session obeys every server that reaches it, and a lease counts for \
         its own connection.",
        &[
            Test("robot/src/robot/tests/sessions.rs::a_robot_without_a_session_obeys_every_server"),
            Test("robot/src/robot/tests.rs::another_servers_messages_renew_nothing"),
        ],
    ),
    (
        Protocol,
        "A control request has to name its session each time, on any connection.",
        &[Test("robot/src/robot/tests/sessions.rs::a_control_request_names_its_session_each_time")],
    ),
    (
        Protocol,
        "A closed connection stops nothing by itself: leases do that.",
        &[
            Conformance("stays-connected", "a new connection goes to the default state"),
            Test(
                "tests/processes/stops/silence.rs::a_link_that_is_cut_in_mid_play_and_back_at_once_cancels_nothing",
            ),
        ],
    ),
    (
        Protocol,
        "Otherwise the robot answers `Failed` and changes nothing: no lease is renewed.",
        &[Test("robot/src/robot/tests/seizing.rs::who_may_not_seize_changes_nothing")],
    ),
    (
        Protocol,
        "The code is `forbidden` if the peer lacks a role or if nothing is proven on the connection, and \
         `malformed` if there is no session.",
        &[Test("robot/src/robot/tests/seizing.rs::who_may_not_seize_changes_nothing")],
    ),
    (
        Protocol,
        "every command that it holds ends, as by an empty script on each device: `Failed`, `cancelled`.",
        &[Test(
            "robot/src/robot/tests/seizing.rs::who_may_seize_takes_a_robot_that_plays_and_it_rests_before_it_is_said_to_be_available",
        )],
    ),
    (
        Protocol,
        "every device comes to rest where it is, and within its acceleration",
        &[Test(
            "robot/src/robot/tests/seizing.rs::what_was_left_moving_slows_down_when_the_robot_is_seized_and_the_next_session_begins_from_there",
        )],
    ),
    (
        Protocol,
        "A robot that is free, or belongs to the session already, treats the request like any other \
         claim, and moves nothing.",
        &[Test(
            "robot/src/robot/tests/seizing.rs::a_robot_that_is_free_or_ones_own_is_not_moved_by_a_seizure",
        )],
    ),
    (
        Protocol,
        "Connections that say nothing, or only half a message, must not keep a server out for longer than \
         10 s: hang up on them, or let them give way to a new one.",
        &[Conformance("silent-peers", "sixteen silent peers are all it serves")],
    ),
    (
        Protocol,
        "Every robot serves a server that keeps to the following: it says something as soon as it is \
         connected, it claims the robot by an availability request before it sends long lines, it reads \
         what it is told, and it asks no more than it needs.",
        &[
            Test(
                "tests/processes/security/attacks.rs::strangers_that_attack_a_robot_delay_no_mission_and_take_no_memory",
            ),
            Test(
                "robot/src/serve/tests.rs::strangers_that_hold_all_places_keep_neither_the_owner_out_nor_its_stop",
            ),
        ],
    ),
    (
        Protocol,
        "brings no whole message within 5 s | is hung up on",
        &[Test(
            "robot/src/serve/tests.rs::a_connection_that_brings_no_message_in_time_is_closed_whatever_it_drips",
        )],
    ),
    (
        Protocol,
        "does not own the robot, and does not end a message within 10 s of its beginning | is hung up on",
        &[Test(
            "robot/src/serve/tests.rs::a_stranger_ends_each_message_in_time_and_the_owner_takes_its_time",
        )],
    ),
    (
        Protocol,
        "does not own the robot, and sends a long line | gets `malformed`: its lines may have at most 64 \
         KiB, or 1 MiB while the robot belongs to no session.",
        &[
            Test("robot/src/serve/tests.rs::how_long_a_line_may_be_depends_on_whose_the_robot_is"),
            Test(
                "robot/src/serve/tests.rs::a_free_robot_reads_no_line_longer_than_its_longest_command_from_a_stranger",
            ),
        ],
    ),
    (
        Protocol,
        "does not own the robot, and is one of many | may have to wait: the robot obeys 16 such \
         connections, and keeps 4 places for its owner.",
        &[
            Test("robot/src/serve/tests.rs::no_more_than_the_limit_of_connections_is_obeyed_at_a_time"),
            Test(
                "robot/src/serve/tests.rs::strangers_that_hold_all_places_keep_neither_the_owner_out_nor_its_stop",
            ),
        ],
    ),
    (
        Protocol,
        "does not own the robot, and is one of even more | gives way: of 64 connections, or of 16 from \
         one host other than the robot's own, one that has no place is closed in favour of a new one, \
         first those that have said nothing",
        &[
            Test(
                "robot/src/serve/tests/places.rs::beyond_all_connections_the_oldest_without_a_place_gives_way_once_it_is_not_young",
            ),
            Test(
                "robot/src/serve/tests.rs::one_host_has_a_share_of_the_connections_and_leaves_the_others_theirs",
            ),
        ],
    ),
    (
        Protocol,
        "Downbeat's robots count these cases, and log each kind once a second at most, with the address \
         of a peer and without any session.",
        &[
            Test("robot/src/refusals.rs::each_reason_is_counted_and_logged_once_a_second"),
            Test("robot/src/peer.rs::a_log_names_a_peer_by_its_proven_name_and_address"),
        ],
    ),
    (
        Protocol,
        "On both ways the robot hangs up on a peer that has not proven who it is within 5 s, and on a \
         connection on which something came that its peer did not send so: nothing of that is heard.",
        &[Conformance("proven-in-time", "Patient"), Conformance("altered", "AnyRecord")],
    ),
    (
        Protocol,
        "The robot accepts only certificates of its authority that are for clients, have not expired and \
         are not on its list of revoked ones.",
        &[
            Test("robot/src/tls/tests.rs::a_door_lets_in_operators_of_its_authority_alone"),
            Test(
                "robot/src/tls/tests.rs::a_door_obeys_a_list_that_was_replaced_and_not_one_that_cannot_be_read",
            ),
        ],
    ),
    (
        Protocol,
        "A claim that is changed takes another pass, which only the secret gives.",
        &[Conformance("forged-roles", "OnePass")],
    ),
    (
        Protocol,
        "The handshake is three lines, each ended by `\\n`, the first two of at most 8,192 bytes with \
         their end.",
        &[Test(
            "robot/sealed/src/tests.rs::a_first_line_is_taken_up_to_the_longest_that_there_may_be_however_it_comes",
        )],
    ),
    (
        Protocol,
        "Nothing proves a refusal, so an operator draws no conclusion from it but that it is not let in.",
        &[
            Test(
                "scheduler/runtime/src/link/secure.rs::from_a_forged_refusal_follows_only_that_the_operator_is_not_let_in",
            ),
            Test("scheduler/mission/src/tests/lost.rs::a_robot_whose_process_is_gone_has_lost_what_it_had"),
        ],
    ),
    (
        Protocol,
        "To a line that begins otherwise the robot says nothing and hangs up.",
        &[Test("robot/sealed/src/tests.rs::what_speaks_something_else_is_not_waited_for")],
    ),
    (
        Protocol,
        "The receiver ends the connection at the first wrong code or length and hears nothing of that \
         record.",
        &[Test(
            "robot/sealed/src/record.rs::a_record_that_is_altered_repeated_left_out_or_out_of_order_ends_it_all",
        )],
    ),
    (
        Protocol,
        "A record carries 16 KiB at most, because a robot has to keep all of it until it knows its code; \
         more memory than that would be needed for nothing but this.",
        &[Test("robot/sealed/src/record.rs::a_length_that_no_record_has_is_not_waited_for")],
    ),
];

/// Sentences that contain a word of a promise but promise no behaviour, each with the reason.
pub const NO_PROMISES: &[(Document, &str, &str)] = &[
    (
        Mission,
        "If the mission sends a later script of a device only after those two thirds, the robot may accept \
         it after the decision.",
        "It limits the promise before it.",
    ),
    (
        Mission,
        "The connections that the stop lane of a running mission keeps do not ask.",
        "It limits the promise before it.",
    ),
    (
        Mission,
        "If an act must not wait for a day, specify a date and time (RFC 3339).",
        "It advises the author of a scenario.",
    ),
    (
        Mission,
        "A robot that does not declare `pending_until` uses only its leases, which count from the receipt \
         of a message.",
        "It describes the difference between this robot and robots that declare more.",
    ),
    (Mission, "Later, the mission can only stop the robots.", "It states a limit of the mission."),
    (Mission, "The mission greets all robots as always.", "It introduces the sentences after it."),
    (
        Mission,
        "A script can start earlier than planned only if there is a pause before it.",
        "It gives the reason for the sentence after it.",
    ),
    (
        Mission,
        "It compares what the robots really set with nine invariants: (a) all or none, (b) nothing late \
         or twice, (c) rest after a stop and beyond a lease, (d) no value outside limits, (e) every \
         mission ends in a report, (f) starts within the printed skew budget, (g) the report is true, (h) \
         silence, gaps and stops in time, (m) no movement without a reason.",
        "It describes the simulation.",
    ),
    (Protocol, "`downbeat schema protocol`: the JSON Schema (2020-12) of every message", "It names a tool."),
    (
        Protocol,
        "The conformance test demands what a robot *must* do, as far as this shows on the wire.",
        "It describes the conformance test.",
    ),
    (
        Protocol,
        "`latency_spread` | number, 0 to 10,000 | no, 0 | D | ms; 95 % of all motions begin within \
         `latency` ± this.",
        "It defines a figure that the maker of a robot states.",
    ),
    (
        Protocol,
        "A robot that does not know the `request_id` takes the request as a new one: a server that only \
         wants to ask sends an inquiry.",
        "It gives the reason for an inquiry.",
    ),
    (Protocol, "This is how all robots start or none does.", "It sums up the sentences around it."),
    (
        Protocol,
        "A limit counts from the receipt, so a message that travels for a long time would extend a lease \
         further than the server intended, and the robot would start a request whose start the server \
         never decided.",
        "It describes the problem that `pending_until` solves.",
    ),
    (
        Protocol,
        "A robot should bound what a peer costs whose session does not own it, so that its owner notices \
         nothing.",
        "It recommends something to the maker of a robot.",
    ),
    (
        Protocol,
        "Each operator has a pass for the robot that is made from it, so the robot stores nothing but its \
         secret and, perhaps, the numbers of revoked passes.",
        "It describes the data that a robot stores.",
    ),
];
