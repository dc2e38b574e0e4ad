/* For tests that draw: one device and one renderer, opened once for all tests of a program.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_RENDER_KIT_H
#define TESTS_RENDER_KIT_H

#include "tests/kit.h"

#include "core/device/dev.h"
#include "render/render.h"

static struct dev dev;
static struct render *render;

/* Setup and teardown of the group. */
static int render_kit_open(void **state)
{
    struct err e = {0};
    kit_ok(dev_open(NULL, &dev, &e), e);
    kit_ok(render_open(&dev, &render, &e), e);
    return 0;
}

static int render_kit_close(void **state)
{
    render_close(&render);
    render_close(&render); /* idempotent */
    dev_close(&dev);
    return 0;
}

#endif
