// Full page of the viewer: mounts it from the socket or the file that the server has.
import { mountControl } from "./control.js";
import { mount, showFailure } from "./viewer.js";

const host = document.getElementById("viewer") ?? document.body;
const record = document.body.dataset.record !== undefined ? new URL("record/", location.href).pathname : "";
const scans = document.body.dataset.scans !== undefined || record ? new URL("record/", location.href).pathname : "";
const address = new URL("stream", location.href);
address.hash = address.search = "";
if (document.body.dataset.source === "socket") {
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  Object.assign(window, { skyrangeViewer: mount(host, { kind: "socket", url: address.href }, { whole: true, record, scans }) });
} else if (document.body.dataset.source === "file") {
  Object.assign(window, { skyrangeViewer: mount(host, { kind: "url", url: address.href }, { whole: true, record, scans }) });
} else showFailure(host, "There is no flight to show", "The page does not say where its flight comes from.");
if (document.body.dataset.control !== undefined) mountControl(host, new URL("control", location.href).href);
