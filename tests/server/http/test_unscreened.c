/* A program in which libmicrohttpd does not get the recv() of server/http/request_screen.c,
 * because its linker was told to hide it: the server asks itself, starts not, and says why. In the
 * other test programs of the server it does, so they start. From libmicrohttpd 1.0 on there is no
 * such recv().
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include "server/http.h"

static void test_refuses_to_start(void **state)
{
    struct err e = {0};
    if (http_is_strict())
        skip();
    kit_fails(server_start(&t.cfg, t.paths, 1, &t.server, &e), ERR_INTERNAL, e, "libmicrohttpd");
}

int main(void)
{
    const struct CMUnitTest tests[] = {HTTP_TEST(test_refuses_to_start)};
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
