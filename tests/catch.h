// catch.h: Catch2, version 2 or 3; and whether the address sanitizer is in this build.
#pragma once

#if defined(__SANITIZE_ADDRESS__)
#define RT_TEST_SANITIZED 1
#elif defined(__has_feature)
#define RT_TEST_SANITIZED __has_feature(address_sanitizer)
#else
#define RT_TEST_SANITIZED 0
#endif

#if RT_CATCH2_VERSION == 3
#include <catch2/catch_approx.hpp>
#include <catch2/catch_message.hpp>
#include <catch2/catch_test_macros.hpp>
#include <catch2/generators/catch_generators.hpp>
#include <catch2/generators/catch_generators_range.hpp>
#else
#include <catch2/catch.hpp>
#endif
