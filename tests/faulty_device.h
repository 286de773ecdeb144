// faulty_device.h: a device with a fault planted in it, for tests of whatever has to find faults.
//
// The wrapper hands every call on to a real device. On the way it edits the kernels' text (a miscompiled expression, a
// wrong constant, another struct layout), swaps programs (a stale kernel binary), or tampers with what is read back.
// An edit that does not apply is an error of build(), never a fault that was silently not planted. A device whose
// kernels are not compiled from text (the reference) cannot take edits.
#pragma once

#include "backends/backend.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace rt {

struct Fault {
	std::string name;               // "unfused product": added to the device's name
	std::vector<TextEdit> edits;    // made in every program, or in those of one root:
	std::string only_root = {};     // "kernels/render.cl"; empty: all
	bool allow_contraction = false; // those programs are built with the compiler's contraction on
	std::uint32_t native_lanes = 0; // that the device says it has, which need be no fault; 0: its own
	bool stale_program = false;     // every build gives the first program that was built for its root
	// Called after each read with what was read, to change it; empty: nothing is changed.
	std::function<void(std::size_t offset, unsigned char* data, std::size_t bytes)> tamper = {};
};

// The device with the fault. Its name tells the fault, so that no verdict about it is remembered for the sound device.
DeviceHandle make_faulty(const DeviceHandle& device, Fault fault);

} // namespace rt
