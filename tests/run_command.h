// run_command.h: a shell's command and what came of it.
#pragma once

#include "tests/catch.h"

#include <cstdio>
#include <string>

#include <sys/wait.h>

struct Outcome {
	int status = -1; // of its exit; -1 if a signal ended it
	std::string out; // its standard output, with what the command sends there
};

inline Outcome run_command(const std::string& command)
{
	std::FILE* pipe = popen(command.c_str(), "r");
	REQUIRE(pipe != nullptr);
	Outcome outcome;
	char buffer[4096];
	for (std::size_t count; (count = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;)
		outcome.out.append(buffer, count);
	const int status = pclose(pipe);
	outcome.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
	return outcome;
}
