/* A program in which libmicrohttpd does not get the recv() of request_screen.c, because its linker
 * was told to hide it: no server starts, and the message says why. In the other test programs of
 * the server it does, so they start.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include "server/base/config.h"
#include "server/http.h"

static void test_refuses_to_start(void **state)
{
    struct server_config cfg;
    struct arena arena = {0};
    struct err e = {0};
    (void)state;
    kit_ok(config_defaults(&cfg, &arena, &e), e);
    kit_fails(http_check(&cfg, &e), ERR_INTERNAL, e, "recv()");
    arena_free(&arena);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_refuses_to_start)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
