"""Sequencing of one flight: state machine, procedures, guided targets, submission to the approval."""
